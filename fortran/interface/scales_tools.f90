!> What the flat routines of the method of multiple scales share.
module viscovib_scales_tools
  use viscovib_binding_tools, only: kernels_in_vector, make_pendulum, make_system, mount_length
  use viscovib_full_oscillator, only: put_behind
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_packed_form, only: unpack_form
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_form, only: put_pendulum_behind
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: make_form

  integer, parameter :: pendulum_length = 14

contains

  !> A form and the system behind it: a mount or a polynomial system as in `make_system`, a
  !! pendulum as in `make_pendulum`, or, where `flat` has another length, none.
  subroutine make_form(packed, flat, kind_x, data_x, kind_phi, data_phi, form, status)
    real(wp), intent(in) :: packed(:), flat(:), data_x(:), data_phi(:)
    integer, intent(in) :: kind_x, kind_phi
    type(polynomial_form_type), intent(out) :: form
    type(status_type), intent(out) :: status
    class(oscillator_type), allocatable :: system
    type(pendulum_type) :: pendulum
    type(kernel_holder) :: none(0)

    if (kind_x == kernels_in_vector .or. size(flat) == mount_length) then
      call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, status)
      if (.not. status%failed()) call unpack_form(packed, system%kernels, form, status)
      if (.not. status%failed()) call put_behind(form, system)
    else
      call unpack_form(packed, none, form, status)
      if (status%failed() .or. size(flat) /= pendulum_length) return
      call make_pendulum(pendulum, flat, status)
      if (.not. status%failed()) call put_pendulum_behind(form, pendulum)
    end if
  end subroutine make_form

end module viscovib_scales_tools
