!> A motion in time of any system, with any kind of equations.
module viscovib_subject_motion
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_hereditary_job, only: hereditary_job, run_hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_motion_choice, only: fastest_rate, hereditary_methods
  use viscovib_pendulum_job, only: run_pendulum_job
  use viscovib_polynomial_job, only: run_polynomial_job
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_status, only: set_ok, status_type
  use viscovib_structure_job, only: rate_of_structure, run_structure_job
  use viscovib_subject, only: subject_type
  use viscovib_transient_job, only: trajectory_type, transient_job
  implicit none
  private

  public :: move_subject, method_of, fastest_of, new_motion

contains

  !> The name of the method.
  function method_of(motion) result(method)
    class(transient_job), intent(in) :: motion
    character(len=:), allocatable :: method
    select type (motion)
    type is (hereditary_job)
      method = trim(hereditary_methods(motion%method))
    class default
      method = trim(transient_methods(motion%method))
    end select
  end function method_of

  !> One motion from a start, by the first method of its kind.
  subroutine new_motion(subject, nu, start, t_end, motion)
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: nu, start(:), t_end
    class(transient_job), allocatable, intent(out) :: motion
    type(hereditary_job), allocatable :: hereditary
    integer :: i

    if (subject%remembers()) then
      allocate (hereditary)
      hereditary%nu = nu
      hereditary%held = [(0.0_wp, i=1, size(start)/2)]
      call move_alloc(hereditary, motion)
    else
      allocate (motion)
    end if
    motion%initial = start
    motion%t_end = t_end
    motion%tolerance = 0.0_wp
  end subroutine new_motion

  !> Integrate the motion.
  subroutine move_subject(motion, subject, nu, places, trajectory, status)
    !> A `hereditary_job` for a system with memory and for a structure.
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load of a system without memory (rad/s).
    real(wp), intent(in) :: nu
    !> Coordinates of a structure that are kept.
    integer, intent(in) :: places(:)
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    real(wp) :: fastest

    select type (motion)
    type is (hereditary_job)
      if (subject%is_structure) then
        call run_structure_job(motion, subject%model, subject%structure, places, trajectory, status)
      else
        call run_hereditary_job(motion, subject%oscillator(), subject%load, &
                                fastest_rate(subject%oscillator()), trajectory, status)
      end if
    type is (transient_job)
      call fastest_of(subject, nu, fastest, status)
      if (status%failed()) return
      if (subject%is_pendulum) then
        call run_pendulum_job(motion, subject%pendulum, fastest, trajectory, status)
      else
        call run_polynomial_job(motion, subject%polynomial, subject%load, nu, fastest, trajectory, &
                                status)
      end if
    end select
  end subroutine move_subject

  !> Frequency of the fastest linear motion, or the frequency that determines the first steps; for a
  !! pendulum including those of its loads.
  subroutine fastest_of(subject, nu, fastest, status)
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu
    real(wp), intent(out) :: fastest
    type(status_type), intent(out) :: status
    type(polynomial_motion_type) :: own
    real(wp) :: omega(3), shapes(3, 3)

    call set_ok(status)
    if (subject%is_pendulum) then
      call subject%pendulum%natural_modes(omega, shapes)
      fastest = max(maxval(omega), maxval(subject%pendulum%drives))
    else if (subject%is_structure) then
      fastest = rate_of_structure(subject%model, subject%structure, nu)
    else if (subject%remembers()) then
      fastest = fastest_rate(subject%oscillator())
    else
      fastest = 0.0_wp
      ! Rates are those of coordinates, for any sums that represent kernels.
      call new_fitted_motion(own, subject%polynomial, subject%load, nu, 1.0_wp, 1.0_wp, status)
      if (.not. status%failed()) fastest = own%fastest()
    end if
  end subroutine fastest_of

end module viscovib_subject_motion
