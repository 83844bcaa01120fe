!> Every kernel by its kind, made from a flat list of numbers, as scenes and
!! bindings hold them.
module viscovib_catalogue
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_prony, only: new_prony, prony_kernel
  use viscovib_rabotnov, only: new_rabotnov, rabotnov_kernel
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_tabulated, only: new_tabulated, tabulated_kernel
  implicit none
  private

  public :: new_kernel

  !> Kinds, and what `parameters` holds for each:
  !! rzhanitsyn, rabotnov: amplitude, alpha, beta; abel: amplitude, alpha;
  !! prony: all weights, all rates; tabulated: interpolation, all times, all
  !! values.
  integer, parameter, public :: kernel_none = 0, kernel_rzhanitsyn = 1, kernel_prony = 2, &
                                kernel_abel = 3, kernel_rabotnov = 4, kernel_tabulated = 5
  character(len=*), parameter, public :: kernel_names(5) = &
    [character(len=10) :: 'rzhanitsyn', 'prony', 'abel', 'rabotnov', 'tabulated']

contains

  subroutine new_kernel(kernel, kind, parameters, status)
    class(kernel_type), allocatable, intent(out) :: kernel
    integer, intent(in) :: kind
    real(wp), intent(in) :: parameters(:)
    type(status_type), intent(out) :: status
    type(rzhanitsyn_kernel) :: rzhanitsyn
    type(prony_kernel) :: prony
    type(rabotnov_kernel) :: rabotnov
    type(tabulated_kernel) :: tabulated
    integer :: n

    call check_length(kind, size(parameters), status)
    if (status%failed()) return
    associate (p => parameters)
      select case (kind)
      case (kernel_rzhanitsyn)
        call new_rzhanitsyn(rzhanitsyn, p(1), p(2), p(3), status)
        allocate (kernel, source=rzhanitsyn)
      case (kernel_abel)
        call new_rzhanitsyn(rzhanitsyn, p(1), p(2), 0.0_wp, status)
        allocate (kernel, source=rzhanitsyn)
      case (kernel_rabotnov)
        call new_rabotnov(rabotnov, p(1), p(2), p(3), status)
        allocate (kernel, source=rabotnov)
      case (kernel_prony)
        n = size(p)/2
        call new_prony(prony, p(:n), p(n + 1:), status)
        allocate (kernel, source=prony)
      case default
        n = (size(p) - 1)/2
        call new_tabulated(tabulated, p(2:n + 1), p(n + 2:), nint(p(1)), status)
        allocate (kernel, source=tabulated)
      end select
    end associate
    if (status%failed()) deallocate (kernel)
  end subroutine new_kernel

  subroutine check_length(kind, n, status)
    integer, intent(in) :: kind, n
    type(status_type), intent(out) :: status
    logical :: fits

    select case (kind)
    case (kernel_rzhanitsyn, kernel_rabotnov)
      fits = n == 3
    case (kernel_abel)
      fits = n == 2
    case (kernel_prony)
      fits = mod(n, 2) == 0
    case (kernel_tabulated)
      fits = mod(n, 2) == 1
    case default
      call fail(status, status_input_error, 'kind', 'kind = '//show(kind) &
                //': must be 1 to '//show(size(kernel_names)))
      return
    end select
    if (.not. fits) call fail(status, status_input_error, 'kernel', 'kernel of kind ' &
                              //trim(kernel_names(kind))//': '//show(n)//' numbers do not fit')
  end subroutine check_length

end module viscovib_catalogue
