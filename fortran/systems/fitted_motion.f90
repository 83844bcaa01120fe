!> A polynomial system in time whose kernels are taken as sums of exponentials where they are none.
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

  !> As `new_polynomial_motion`, in sections.
  subroutine new_fitted_motion(motion, system, load, nu, step, reach, status, taken)
    type(polynomial_motion_type), intent(out) :: motion
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Steps of the run, and latest time of any that goes on from it; rates of coordinates are the
    !! same for all.
    real(wp), intent(in) :: nu, step, reach
    type(status_type), intent(out) :: status
    !> The system with the sums, if there are any.
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
