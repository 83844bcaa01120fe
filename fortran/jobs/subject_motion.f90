!> A motion in time of any system, with any kind of equations.
module viscovib_subject_motion
  use viscovib_dense, only: factorize, solve
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_hereditary_job, only: hereditary_job, hereditary_methods, run_hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_oscillator, only: oscillator_type
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
                                fastest_frequency(subject), trajectory, status)
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
      fastest = fastest_frequency(subject)
    else
      fastest = 0.0_wp
      ! Rates are those of coordinates, for any sums that represent kernels.
      call new_fitted_motion(own, subject%polynomial, subject%load, nu, 1.0_wp, 1.0_wp, status)
      if (.not. status%failed()) fastest = own%fastest()
    end if
  end subroutine fastest_of

  !> Fastest natural frequency of a mount, or an upper bound of the rates of a polynomial
  !! system.
  real(wp) function fastest_frequency(subject) result(fastest)
    type(subject_type), intent(in), target :: subject
    real(wp) :: omega(2), shapes(2, 2)

    if (subject%is_turning) then
      fastest = largest_rate(subject%turning, subject%turning%n_dof())
    else if (subject%is_polynomial) then
      fastest = largest_rate(subject%polynomial, subject%polynomial%n_dof())
    else
      call subject%mount%natural_modes(omega, shapes)
      fastest = omega(2)
    end if
  end function fastest_frequency

  !> Largest row sum of M^-1 K, its root, plus the largest row sum of M^-1 C.
  real(wp) function largest_rate(system, n)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: n
    real(wp) :: mass(n, n), pull(n, n), drag(n, n)
    integer :: pivots(n), k
    logical :: singular

    mass = system%mass
    pull = matmul(system%spread, system%gather)
    drag = system%damping
    call factorize(n, mass, pivots, singular)
    do k = 1, n
      call solve(n, mass, pivots, pull(:, k))
      call solve(n, mass, pivots, drag(:, k))
    end do
    largest_rate = sqrt(maxval(sum(abs(pull), 2))) + maxval(sum(abs(drag), 2))
  end function largest_rate

end module viscovib_subject_motion
