!> Every kernel by its kind (first version, to be completed).
module viscovib_catalogue
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: new_kernel

  integer, parameter, public :: kernel_none = 0, kernel_rzhanitsyn = 1

contains

  subroutine new_kernel(kernel, kind, data, status)
    class(kernel_type), allocatable, intent(out) :: kernel
    integer, intent(in) :: kind
    real(wp), intent(in) :: data(:)
    type(status_type), intent(out) :: status
    type(rzhanitsyn_kernel) :: made

    if (kind /= kernel_rzhanitsyn .or. size(data) /= 3) then
      call fail(status, status_input_error, 'kernel', 'kind = '//show(kind))
      return
    end if
    call new_rzhanitsyn(made, data(1), data(2), data(3), status)
    if (.not. status%failed()) allocate (kernel, source=made)
  end subroutine new_kernel

end module viscovib_catalogue
