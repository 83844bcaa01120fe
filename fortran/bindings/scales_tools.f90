!> What the flat routines of the method of multiple scales share.
module viscovib_scales_tools
  use viscovib_binding_tools, only: kernel_as_x
  use viscovib_catalogue, only: kernel_none, new_kernel
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: kernel_holder
  use viscovib_packed_form, only: unpack_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: make_form

contains

  !> Kernels as the mount's: the second may be none, another, or the first.
  subroutine make_form(packed, kind_x, data_x, kind_phi, data_phi, form, status)
    real(wp), intent(in) :: packed(:), data_x(:), data_phi(:)
    integer, intent(in) :: kind_x, kind_phi
    type(polynomial_form_type), intent(out) :: form
    type(status_type), intent(out) :: status
    type(kernel_holder) :: kernels(2)
    integer :: n

    n = 0
    if (kind_x /= kernel_none) then
      n = n + 1
      call new_kernel(kernels(n)%kernel, kind_x, data_x, status)
      if (status%failed()) return
    end if
    if (kind_phi /= kernel_none .and. kind_phi /= kernel_as_x) then
      n = n + 1
      call new_kernel(kernels(n)%kernel, kind_phi, data_phi, status)
      if (status%failed()) return
    end if
    call unpack_form(packed, kernels(:n), form, status)
  end subroutine make_form

end module viscovib_scales_tools
