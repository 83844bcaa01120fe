!> Accelerations of the states that a motion in time has kept, by the equations of motion.
!!
!! A motion whose laws have surfaces, or with memory of exponentials, is made once more, and its
!! equations give them on the side of each surface on which the motion is. Other oscillators are
!! looked at in all their coordinates; what they remember follows from the motion at the points of
!! its steps.
module viscovib_motion_accelerations
  use viscovib_kinds, only: wp
  use viscovib_known_motion, only: base_at, know_motion, known_motion, load_at, own_forces, &
    repeat_motion
  use viscovib_load, only: load_type
  use viscovib_motion_balance, only: accelerations_of, recalled_along
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: transient_job
  use viscovib_whole_structure, only: may_be_whole, whole_polynomial
  implicit none
  private

  public :: find_accelerations

contains

  !> Accelerations of the body, a column for each time of the trajectory.
  subroutine find_accelerations(motion, subject, nu, trajectory, accelerations, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (subject%is_pendulum) then
      call of_pendulum(subject, trajectory, accelerations)
      return
    end if
    if (own_forces(motion, subject)) then
      call along_once_more(motion, subject, nu, trajectory, accelerations, status)
    else
      call by_balance(motion, subject, nu, trajectory, accelerations, status)
    end if
  end subroutine find_accelerations

  subroutine of_pendulum(subject, trajectory, accelerations)
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    real(wp) :: none(0)
    integer :: i
    associate (pendulum => subject%pendulum)
      allocate (accelerations(pendulum%n_dof, size(trajectory%t)))
      do i = 1, size(trajectory%t)
        call pendulum%law_forces(trajectory%t(i), trajectory%states(1::2, i), &
                                 trajectory%states(2::2, i), accelerations(:, i), none)
      end do
    end associate
  end subroutine of_pendulum

  subroutine along_once_more(motion, subject, nu, trajectory, accelerations, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status
    type(trajectory_type) :: again
    real(wp), allocatable :: moved(:, :, :)
    integer :: n

    call repeat_motion(motion, subject, nu, trajectory, trajectory%t, .true., again, status)
    if (status%failed()) return
    n = size(motion%initial)/2
    call base_at(subject, nu, trajectory%t, moved)
    allocate (accelerations(n, size(trajectory%t)))
    accelerations = again%accelerations(:n, :) + moved(:, :, 3)
  end subroutine along_once_more

  !> By the balance of forces in all coordinates.
  subroutine by_balance(motion, subject, nu, trajectory, accelerations, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status
    type(polynomial_type), target :: whole
    class(oscillator_type), pointer :: system
    type(load_type), pointer :: load
    type(known_motion) :: known
    real(wp), allocatable :: recalled(:, :), a(:, :)
    logical :: singular

    load => subject%load
    call set_ok(status)
    if (.not. subject%is_structure) then
      system => subject%oscillator()
    else if (may_be_whole(subject%model)) then
      load => subject%model%load
      call whole_polynomial(subject%model, subject%structure%kernels, whole, status)
      system => whole
    else
      call fail(status, status_input_error, 'acceleration', "acceleration = 'yes': is for " &
                //'structures of at most 512 coordinates, all with mass, not reduced, without ' &
                //'loss factors')
    end if
    if (status%failed()) return
    call know_motion(motion, subject, nu, trajectory, known, status)
    if (status%failed()) return
    allocate (recalled(size(trajectory%t), system%n_memory()), source=0.0_wp)
    if (allocated(known%ends)) call recalled_along(system, known%ends, known%panel_u, &
      known%panel_rate, known%held, trajectory%t, recalled)
    allocate (a(size(known%u, 1), size(known%u, 2)))
    call accelerations_of(system, known%u, known%rate, load_at(system, load, nu, trajectory%t), &
                          recalled, a, singular)
    allocate (accelerations, source=transpose(a))
    accelerations = accelerations + known%moved(:, :, 3)
  end subroutine by_balance

end module viscovib_motion_accelerations
