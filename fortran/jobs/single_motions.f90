!> Motions of any system from many starts, one after another: for systems that cannot run in lanes,
!! since their steps end where laws switch, or since they have memory.
module viscovib_single_motions
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: i8, wp
  use viscovib_many_motions, only: many_motions
  use viscovib_simulate, only: run_completed
  use viscovib_status, only: set_ok, status_type
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: move_subject
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: transient_job
  implicit none
  private

  public :: make_singles, step_of_singles

  !> Largest factor of the number of steps for resolving thin layers of laws.
  integer, parameter :: most_parts = 1024
  !> Number of states on the way that determine the size of a motion.
  integer(i8), parameter :: most_looks = 1000_i8

contains

  !> All motions in n steps each: last states, and the requested last points.
  subroutine make_singles(subject, nu, starts, t_end, n, n_periods, n_points, peaks, many, &
                          status)
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load; 0 if it has none.
    real(wp), intent(in) :: nu
    !> States at t = 0 after rest, one column per motion.
    real(wp), intent(in) :: starts(:, :), t_end
    !> Number of steps; with periods, a multiple of their number.
    integer(i8), intent(in) :: n
    !> Periods, and number of kept states at the ends of the last ones; 0: none.
    integer, intent(in) :: n_periods, n_points
    !> Whether to compute the largest value of each number on the way, without points.
    logical, intent(in) :: peaks
    type(many_motions), intent(out) :: many
    type(status_type), intent(out) :: status
    class(transient_job), allocatable :: motion
    type(trajectory_type) :: trajectory
    integer(i8) :: every
    integer :: i, k, last, places(size(starts, 1)/2), width

    call set_ok(status)
    width = size(starts, 1)
    places = [(i, i=1, size(places))]
    allocate (many%state(width, size(starts, 2)), source=0.0_wp)
    allocate (many%sections(width, n_points, size(starts, 2)), source=0.0_wp)
    allocate (many%ended(size(starts, 2)))
    if (peaks) allocate (many%peak(width, size(starts, 2)), source=0.0_wp)
    every = n/max(n_periods, 1)
    if (peaks) every = max(1_i8, n/most_looks)
    do i = 1, size(starts, 2)
      k = 1
      do
        call new_motion(subject, nu, starts(:, i), t_end, motion)
        motion%dt = t_end/(n*k)
        motion%last_only = n_points == 0 .and. .not. peaks
        if (.not. motion%last_only) motion%save_every = int(every*k)
        call move_subject(motion, subject, nu, places, trajectory, status)
        if (status%failed()) return
        if (.not. trajectory%too_long > 1.0_wp .or. k >= most_parts) exit
        k = 2*k
      end do
      many%ended(i) = trajectory%outcome
      last = size(trajectory%states, 2)
      many%state(:, i) = trajectory%states(:, last)
      if (peaks) many%peak(:, i) = maxval(abs(trajectory%states), 2)
      if (trajectory%outcome /= run_completed) cycle
      many%sections(:, :, i) = trajectory%states(:, last - n_points + 1:)
    end do
  end subroutine make_singles

  !> The shortest of the steps that integrate each of some motions to a relative error.
  subroutine step_of_singles(subject, nu, starts, t_end, relative, dt, status)
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu, starts(:, :), t_end, relative
    real(wp), intent(out) :: dt
    type(status_type), intent(out) :: status
    class(transient_job), allocatable :: motion
    type(trajectory_type) :: trajectory
    integer :: i, places(size(starts, 1)/2)

    call set_ok(status)
    places = [(i, i=1, size(places))]
    dt = t_end
    do i = 1, size(starts, 2)
      call new_motion(subject, nu, starts(:, i), t_end, motion)
      motion%relative = relative
      motion%last_only = .true.
      call move_subject(motion, subject, nu, places, trajectory, status)
      if (status%failed()) return
      dt = min(dt, trajectory%h)
    end do
  end subroutine step_of_singles

  !> One motion from a start, by the first method of its kind.
  subroutine new_motion(subject, nu, start, t_end, motion)
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: nu, start(:), t_end
    class(transient_job), allocatable, intent(out) :: motion
    type(hereditary_job), allocatable :: hereditary
    integer :: i

    if (subject%is_structure .or. subject%remembers()) then
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

end module viscovib_single_motions
