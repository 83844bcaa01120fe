! Optimize: -O1
!> Equations of motion of a polynomial system, with other kernels fitted by sums of exponentials.
module viscovib_fitted_motion
  use viscovib_fitted_memory, only: copy_system, fit_memory, needs_fit
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: new_polynomial_motion, polynomial_motion_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: new_fitted_motion

contains

  !> Like `new_polynomial_motion` with `in_sections=.true.`.
  subroutine new_fitted_motion(motion, system, load, nu, step, reach, status, taken)
    type(polynomial_motion_type), intent(out) :: motion
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Load frequency, step size, and latest time of this run and its continuations. All runs use
    !! the same rates of exponentials.
    real(wp), intent(in) :: nu, step, reach
    type(status_type), intent(out) :: status
    !> The system with the fitted sums, or a copy of `system` if no fit is needed.
    type(polynomial_type), intent(out), optional :: taken
    type(polynomial_type) :: fitted

    if (needs_fit(system)) then
      call fit_memory(system, step, reach, fitted)
      call new_polynomial_motion(motion, fitted, load, nu, status, in_sections=.true.)
      if (present(taken)) call copy_system(fitted, taken)
    else
      if (present(taken)) call copy_system(system, taken)
      call new_polynomial_motion(motion, system, load, nu, status, in_sections=.true.)
    end if
  end subroutine new_fitted_motion

end module viscovib_fitted_motion
