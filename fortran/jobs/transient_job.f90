!> A motion in time as one job: from a start at rest or not, to an end, with the
!! step given or found.
module viscovib_transient_job
  use viscovib_gathered, only: single_request
  use viscovib_kinds, only: i8, wp
  use viscovib_mesh, only: extend_ends, first_after
  use viscovib_motion_request, only: part_of_size, transient_job
  use viscovib_neighbouring_runs, only: gather_run
  use viscovib_piece_runs, only: piece_runs, shared_type
  use viscovib_search_reason, only: find_reason, max_kept
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_step_search, only: find_step, max_numbers, max_steps, search_type, step_found
  use viscovib_trajectory, only: hopeless, trajectory_type
  implicit none
  private

  public :: transient_job, trajectory_type
  public :: run_motion, first_steps, hopeless, max_kept, max_steps

  !> Largest number of steps of a first run whose step is searched.
  real(wp), parameter :: max_first_steps = 1.0e9_wp

contains

  !> Number of first steps: as given by dt, or if the step is searched, about the
  !! given number.
  pure real(wp) function first_steps(job, wanted) result(n)
    class(transient_job), intent(in) :: job
    real(wp), intent(in) :: wanted
    if (job%dt > 0.0_wp) then
      n = ceiling(job%t_end/job%dt*(1.0_wp - 1.0e-12_wp), i8)
    else
      n = job%save_every*real(ceiling(max(real(ceiling(wanted, i8), wp), 1.0_wp) &
                                      /job%save_every, i8), wp)
    end if
  end function first_steps

  !> One run with the step given, or runs with decreasing steps until the tolerance is met. Steps
  !! end on the corners of the loads.
  subroutine run_motion(runs, job, wanted, corners, at_first, trajectory, status)
    !> With its equations, its tolerance, and the storage of the past.
    type(piece_runs), intent(inout) :: runs
    class(transient_job), intent(in), target :: job
    !> First number of steps if the step is searched.
    real(wp), intent(in) :: wanted
    !> Ascending; smallest number of steps until the first.
    real(wp), intent(in) :: corners(:)
    integer, intent(in) :: at_first
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(shared_type), target :: shared
    type(search_type) :: search
    !> The search compares only kept states, and does not require low peaks between them.
    class(transient_job), allocatable :: checked
    real(wp) :: n
    integer :: i

    runs%first%initial => job%initial
    runs%first%is_watched = allocated(job%watched)
    if (runs%first%is_watched) runs%first%watched => job%watched
    runs%first%accelerates = job%accelerates
    runs%t_end = job%t_end
    runs%last_only = job%last_only
    runs%tail = job%tail
    runs%at_times = allocated(job%times)
    if (runs%at_times) runs%first%times = job%times
    allocate (checked, source=job)
    checked%last_only = job%last_only .or. runs%at_times .or. job%tail > 0.0_wp
    runs%looks = checked%last_only .and. .not. job%dt > 0.0_wp
    runs%rows = [(i, i=1, size(job%initial))]
    if (allocated(job%gathers)) then
      call gather_along(runs, job, wanted, trajectory, status)
      return
    end if
    n = first_steps(job, min(wanted, 2.0_wp*max_steps))
    call check_work(job, n, status)
    if (status%failed()) return
    runs%first%h = job%t_end/n
    if (size(corners) > 0) then
      call end_on_corners(runs, job, int(n, i8), corners, at_first, status)
      if (status%failed()) return
    end if
    call runs%begin(shared)
    if (job%dt > 0.0_wp) then
      call runs%make(job, int(n, i8), 1, 1, trajectory, status)
      return
    end if
    call find_step(runs, checked, int(n, i8), search, status)
    if (status%failed()) return
    if (search%verdict == step_found) then
      trajectory = search%run
    else
      call explain(job, n, search, status)
    end if
  end subroutine run_motion

  !> One run of which results are gathered on the way, or its first number of steps only.
  subroutine gather_along(runs, job, wanted, trajectory, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    real(wp), intent(in) :: wanted
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(piece_runs) :: made
    type(single_request) :: its
    type(shared_type), target :: shared
    integer :: i

    call set_ok(status)
    trajectory%n_steps = ceiling(min(max(wanted, 1.0_wp), 2.0_wp*max_steps), i8)
    associate (request => job%gathers)
      if (request%n_steps == 0) return
      made = runs
      made%first%h = job%t_end/request%n_steps
      made%first%in_parts = request%in_parts
      if (allocated(job%watched)) made%first%sides = [(0, i=1, 3*nint(job%watched(1)))]
      shared%longest = request%longest
      its = request
      its%quarter = max(1_i8, nint(real(request%n_steps, wp)/trajectory%n_steps, i8))
      allocate (trajectory%gathered)
      call gather_run(made, its, shared, trajectory%gathered, status)
    end associate
  end subroutine gather_along

  !> Steps that end on corners, and the times after n equal steps, if these are the states wanted.
  subroutine end_on_corners(runs, job, n, corners, at_first, status)
    type(piece_runs), intent(inout) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    real(wp), intent(in) :: corners(:)
    integer, intent(in) :: at_first
    type(status_type), intent(out) :: status
    real(wp), allocatable :: times(:)
    integer(i8) :: count, i

    call set_ok(status)
    associate (first => runs%first)
      if (allocated(job%ends)) then
        first%ends = job%ends
        first%made_by = job%made_by
      else
        first%ends = [real(wp) ::]
        first%made_by = [integer(i8) ::]
        call extend_ends(first%ends, first%made_by, first%h, corners, job%t_end)
        first%made_by = first%made_by + max(0_i8, at_first - first%made_by(1))
      end if
      count = first%made_by(size(first%made_by))
      if (real(count, wp) > max_steps) then
        call fail(status, status_input_error, 'load', 'load: takes '//show(real(count, wp)) &
                  //' steps, must be at most '//show(max_steps))
        return
      end if
      ! Memory is represented for the shortest step.
      if (runs%equations%collocated) runs%later = first_after(corners, job%t_end)
      if (.not. job%dt > 0.0_wp .or. runs%at_times .or. runs%last_only) return
      allocate (times(n/job%save_every + 1))
      do i = 0, size(times) - 1
        times(i + 1) = real(i*job%save_every, wp)*(job%t_end/real(n, wp))
      end do
      if (mod(n, int(job%save_every, i8)) == 0) times(size(times)) = job%t_end
      if (job%tail > 0.0_wp) then
        times = pack(times, times >= times(size(times)) - job%tail*(1.0_wp + 1.0e-12_wp))
      end if
      runs%at_times = .true.
      first%times = times
    end associate
  end subroutine end_on_corners

  !> Set the message of a search that found no step.
  subroutine explain(job, n, search, status)
    class(transient_job), intent(in) :: job
    !> Steps of the first run.
    real(wp), intent(in) :: n
    type(search_type), intent(in) :: search
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: outcome, cause
    integer :: place

    call find_reason(job, int(n, i8), search, outcome, cause, place)
    call fail(status, status_input_error, 'tolerance', accuracy(job)//': '//outcome//': '//cause)
  end subroutine explain

  !> Check that a run of n steps is affordable, before the first one.
  subroutine check_work(job, n, status)
    class(transient_job), intent(in) :: job
    real(wp), intent(in) :: n
    type(status_type), intent(out) :: status
    real(wp) :: most

    call set_ok(status)
    most = max_numbers/size(job%initial)
    if (job%dt <= 0.0_wp .and. n > max_first_steps) then
      call fail(status, status_input_error, 't_end', 't_end = '//show(job%t_end)//': takes ' &
                //show(n)//' steps of the fastest motion or load, must be at most ' &
                //show(max_first_steps)//': use a shorter run, slower loads or softer springs, ' &
                //'or give dt')
    else if (.not. job%last_only .and. n/job%save_every > most) then
      call fail(status, status_input_error, 'save_every', 'save_every = ' &
                //show(job%save_every)//': would keep '//show(n/job%save_every) &
                //' states, must be at most '//show(most)//': take more steps between states ' &
                //'kept, a shorter run or keep = ''last''')
    end if
  end subroutine check_work

  !> The required accuracy, as given.
  function accuracy(job)
    class(transient_job), intent(in) :: job
    character(len=:), allocatable :: accuracy
    accuracy = 'tolerance = '//show(job%tolerance)
    if (job%by_size()) accuracy = 'tolerance = '//show(part_of_size)//' of the size of the motion'
    if (job%relative > 0.0_wp) accuracy = 'rtol = '//show(job%relative)//', atol = ' &
                                      //show(job%tolerance)
  end function accuracy

end module viscovib_transient_job
