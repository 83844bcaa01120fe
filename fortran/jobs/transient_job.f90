!> A motion in time as one job: from a start at rest or not, to an end, with the
!! step given or found.
module viscovib_transient_job
  use viscovib_constants, only: pi
  use viscovib_driven_runs, only: driven_runs
  use viscovib_driven_system, only: driven_system_type
  use viscovib_event_errors, only: differences_type, find_differences, tell_error
  use viscovib_kinds, only: i8, wp
  use viscovib_limits, only: min_time_tolerance
  use viscovib_run_maker, only: part_of_size, run_maker, transient_job
  use viscovib_simulate, only: run_completed, run_event, run_names, run_stopped
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_trajectory, only: change_of, compare, grown_of, hopeless, off_of, risen, &
    trajectory_type
  implicit none
  private

  public :: driven_runs, transient_job, trajectory_type, run_maker
  public :: run_transient, make_runs, first_steps, hopeless

  !> Halvings of the step at most.
  integer, parameter :: max_halvings = 12
  !> Steps before a stop that two runs must differ by: a first step with memory ends as the
  !! second of half its length does, and what follows a step that fails is found by steps of
  !! its own.
  integer, parameter :: few = 4
  !> Bounds that stop a slip of the pen before it fills the memory or the year.
  real(wp), parameter, public :: max_steps = 1.0e12_wp, max_kept = 2.0e7_wp
  !> Steps of a first run whose step is to be found, and numbers kept of any run.
  real(wp), parameter :: max_first_steps = 1.0e9_wp, max_numbers = 2.0_wp**27
  !> Steps up to which a layer of a law is gone after.
  real(wp), parameter :: most_for_layers = 65536.0_wp
  !> What polynomials follow, as a part of what nodes see.
  real(wp), parameter :: followed = 0.05_wp
  !> Height of peaks between states kept above them, relative; states and parts of a step
  !! that are kept for it at most.
  real(wp), parameter :: peaks = 2.0e-3_wp, most_states = 1.0e5_wp
  integer, parameter :: most_parts = 64
  !> Part of a motion within which a run is near enough to it to tell what roundings become; what
  !! a motion is left with where they do not grow.
  real(wp), parameter :: near = 1.0e-3_wp, few_roundings = 64.0_wp*4.0_wp*epsilon(1.0_wp)
  !> How far runs may differ on the way to a last state.
  real(wp), parameter :: one_motion = 1.0e-6_wp
  !> States that a run which stops keeps at least; halvings of the step by which these are made
  !! exact, before they are given up.
  integer, parameter :: states_at_stop = 100, halvings_at_stop = 6

  !> What roundings become along a motion, of each row of states (not allocated: not looked at), as
  !! far as two runs or that tell, and the first run that is near enough to tell, in steps shorter
  !! by the factor.
  type :: growth_type
    type(trajectory_type) :: run
    integer :: factor = 0
    real(wp), allocatable :: grown(:)
    real(wp) :: told = 0.0_wp
  end type growth_type

contains

  !> Steps to begin with: those asked for, or where the step is to be found, about as
  !! many as are given.
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

  subroutine run_transient(job, system, fastest, trajectory, status, other, part)
    class(transient_job), intent(in) :: job
    class(driven_system_type), intent(in), target :: system
    !> Fastest frequency of the system and its loads: four steps a period to begin with.
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    !> As of `driven_runs`.
    class(driven_system_type), intent(in), target, optional :: other
    real(wp), intent(in), optional :: part
    type(driven_runs) :: maker

    maker%system => system
    if (present(other)) maker%other => other
    if (present(part)) maker%part = part
    call make_runs(maker, job, job%t_end*fastest/(0.5_wp*pi), trajectory, status)
  end subroutine run_transient

  !> One run with the step given, or runs in ever smaller steps until the tolerance is
  !! met.
  subroutine make_runs(maker, job, wanted, trajectory, status)
    class(run_maker), intent(in) :: maker
    class(transient_job), intent(in) :: job
    !> Steps to begin with where the step is to be found.
    real(wp), intent(in) :: wanted
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(trajectory_type) :: coarse
    real(wp) :: n, change, changes(max_halvings)
    real(wp), allocatable :: lost(:)
    type(growth_type) :: growth
    type(differences_type) :: differences
    integer :: i, factor, n_changes
    logical :: met

    n = first_steps(job, min(wanted, 2.0_wp*max_steps))
    call check_work(job, n, status)
    if (status%failed()) return
    factor = 1
    if (job%dt > 0.0_wp) then
      call maker%make(job, int(n, i8), factor, trajectory, status)
      return
    end if
    call maker%make(job, int(n, i8), factor, coarse, status)
    if (status%failed()) return
    if (coarse%outcome == run_stopped) then
      trajectory = coarse
      return
    end if
    n_changes = 0
    do i = 1, max_halvings
      factor = 2*factor
      change = huge(1.0_wp)
      if (.not. job%last_only .and. n/job%save_every > max_kept) exit
      if (n*factor > max_steps) exit
      call maker%make(job, int(n, i8)*factor, factor, trajectory, status)
      if (status%failed() .or. trajectory%outcome == run_stopped) return
      call maker%align(coarse, trajectory)
      call judge(maker, job, int(n, i8), factor, coarse, trajectory, lost, change, met, status)
      if (status%failed()) return
      call look_at_growth(maker, job, int(n, i8), factor, coarse, trajectory, growth, change, &
                          met, status)
      if (status%failed()) return
      if (met .and. trajectory%too_long > 1.0_wp) then
        ! Two runs agree that have both missed a layer.
        call shorten()
        if (status%failed()) return
        cycle
      end if
      if (met) then
        call find_differences(coarse, trajectory, growth%told, .not. maker%renames(), differences)
        call fill_in(maker, job, int(n, i8), factor, trajectory, change)
        call tell_error(trajectory, coarse, change, differences, job%watched)
        return
      end if
      coarse = trajectory
      n_changes = n_changes + 1
      changes(n_changes) = change
      if (.not. hopeless(changes(:n_changes))) cycle
      ! Halving gains nothing before what a law depends on is followed.
      if (trajectory%outcome /= run_completed .or. trajectory%too_long <= followed) exit
      n_changes = 0
      call shorten()
      if (status%failed()) return
    end do
    if (.not. allocated(trajectory%states)) then
      call fail(status, status_input_error, 't_end', 't_end = '//show(job%t_end)//': takes ' &
                //show(n)//' steps, and twice as many, which would tell the error, are too many ' &
                //'(at most '//show(max_steps)//', and '//show(max_kept)//' states kept): take ' &
                //'a shorter run or give dt')
      return
    end if
    call fail(status, status_input_error, 'tolerance', told(job)//': not met with ' &
              //show(n*factor)//' steps ('//told_change(change)//'): ' &
              //cause(job, trajectory, change))

  contains

    !> Steps whose nodes see the layers that those of this run may have missed.
    subroutine shorten()
      integer :: times
      ! How thin a layer is shows as steps come near it.
      times = merge(2, 4, trajectory%too_long <= 2.0_wp)
      if (n*factor*times > most_for_layers) then
        call fail(status, status_input_error, 'tolerance', told(job)//': not met with ' &
                  //show(n*factor*times)//' steps: a law changes in a layer thinner than a step ' &
                  //'(take dt below that, or a wider layer)')
        return
      end if
      factor = factor*times
      call maker%make(job, int(n, i8)*factor, factor, coarse, status)
    end subroutine shorten

  end subroutine make_runs

  !> Difference of a run from a run with twice the step size, and whether both meet the tolerance.
  !! Both runs may have the same error from a kink next to an end of all their steps. A run with one
  !! more step for each first step has different ends of steps.
  subroutine judge(maker, job, n, factor, coarse, fine, lost, change, met, status)
    class(run_maker), intent(in) :: maker
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor
    type(trajectory_type), intent(inout) :: coarse, fine
    !> As of `compare`.
    real(wp), allocatable, intent(inout) :: lost(:)
    real(wp), intent(out) :: change
    logical, intent(out) :: met
    type(status_type), intent(out) :: status
    type(trajectory_type) :: other
    real(wp) :: allowed(size(fine%states, 1)), apart
    call set_ok(status)
    apart = parted(maker, job, coarse, fine)
    change = max(change_of(coarse, fine), apart)
    if (change < huge(1.0_wp) .and. fine%outcome == run_completed) then
      allowed = job%allowed(fine)
      met = .not. apart > 0.0_wp .and. all(off_of(coarse, fine) <= allowed)
    else
      allowed = job%allowed_at_stop(fine)
      met = change <= allowed(1) .and. (fine%n_steps == 0 .or. fine%n_steps >= few)
    end if
    if (.not. fine%over_kinks) return
    if (met .and. allocated(lost)) then
      call maker%make(job, n*(factor + 1), factor + 1, other, status)
      if (status%failed()) return
      call maker%align(other, fine)
      lost = max(lost, off_of(other, fine))
    end if
    call compare(coarse, fine, allowed, lost, change, met)
  end subroutine judge

  !> What roundings have grown to counts, too: once, as rough as will do, and only where the runs at
  !! hand do not tell it. What start and numbers bring may cancel: where it grows both signs count.
  subroutine look_at_growth(maker, job, n, factor, coarse, fine, growth, change, met, status)
    class(run_maker), intent(in) :: maker
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor
    type(trajectory_type), intent(in) :: coarse, fine
    type(growth_type), intent(inout) :: growth
    real(wp), intent(inout) :: change
    logical, intent(in) :: met
    type(status_type), intent(out) :: status
    type(trajectory_type) :: other
    real(wp) :: allowed(size(fine%states, 1)), grown(size(fine%states, 1)), rise
    integer :: sign
    call set_ok(status)
    growth%told = 0.0_wp
    if (growth%factor == 0 .and. (met .or. change <= near*maxval(abs(fine%states)))) then
      growth%run = coarse
      growth%factor = factor/2
    end if
    if (.not. met) return
    if (.not. allocated(growth%grown)) then
      rise = risen(coarse, fine)
      if (rise < huge(1.0_wp)) then
        growth%told = rise
        change = max(change, rise)
        return
      end if
      do
        do sign = 1, -1, -2
          call maker%make_shaken(job, n*growth%factor, growth%factor, sign, other, status)
          if (status%failed() .or. .not. allocated(other%states)) return
          call maker%align(other, growth%run)
          grown = grown_of(growth%run, other)
          if (sign == -1) grown = max(grown, growth%grown)
          growth%grown = grown
          if (all(grown <= few_roundings*maxval(abs(growth%run%states)))) exit
        end do
        if (all(growth%grown < huge(1.0_wp)) .or. growth%factor == factor) exit
        ! A coarse run may stop where a finer one does not.
        growth%run = fine
        growth%factor = factor
      end do
    end if
    growth%told = maxval(growth%grown)
    change = max(change, growth%told)
    allowed = job%allowed_at_stop(fine)
    if (fine%outcome == run_completed) allowed = job%allowed(fine)
    if (all(growth%grown <= allowed)) return
    if (.not. all(growth%grown < huge(1.0_wp))) then
      call fail(status, status_input_error, 'tolerance', told(job)//': not met: with numbers of ' &
                //'the system changed by rounding errors the run ends differently: the motion is ' &
                //'chaotic or unstable, take a shorter run or a larger tolerance')
      return
    end if
    if (fine%outcome == run_event) then
      call fail(status, status_input_error, 'tolerance', told(job)//': not met: roundings leave ' &
                //'an error of '//show(growth%told)//' of the event that ends the run at t = ' &
                //show(fine%t_reached)//': it is close to grazing, or the motion is chaotic or ' &
                //'unstable, take a larger tolerance')
      return
    end if
    call fail(status, status_input_error, 'tolerance', told(job)//': not met: the motion makes ' &
              //'roundings of the numbers of the system ' &
              //show(maxval(growth%grown)/epsilon(1.0_wp))//' times as large until t = ' &
              //show(fine%t_reached)//', which leaves an error of '//show(maxval(growth%grown)) &
              //': the motion is chaotic or unstable, take a shorter run or a larger tolerance')
  end subroutine look_at_growth

  !> How far runs with different step sizes differ, in words.
  pure function told_change(change)
    real(wp), intent(in) :: change
    character(len=:), allocatable :: told_change
    told_change = 'runs with different step sizes end differently'
    if (change < huge(1.0_wp)) told_change = 'states still change by '//show(change)
  end function told_change

  !> By how much two runs that keep the last state alone differ on the way, where that tells that
  !! they are not one motion, else 0: those that pass through chaos may end alike by chance.
  real(wp) function parted(maker, job, coarse, fine) result(change)
    class(run_maker), intent(in) :: maker
    class(transient_job), intent(in) :: job
    type(trajectory_type), intent(in) :: coarse, fine
    type(trajectory_type) :: one, other
    real(wp), allocatable :: off(:), allowed(:)
    change = 0.0_wp
    if (.not. (allocated(coarse%looks) .and. allocated(fine%looks))) return
    if (size(coarse%looks, 2) /= size(fine%looks, 2) .or. size(fine%looks, 2) == 0) return
    one = coarse
    other = fine
    one%states = coarse%looks
    other%states = fine%looks
    call maker%align(one, other)
    off = maxval(abs(other%states - one%states), 2)
    allowed = max(job%allowed(other), one_motion*maxval(abs(other%states), 2))
    if (any(off > allowed)) change = maxval(off)
  end function parted

  !> Whether a run of n steps is affordable, before the first of them.
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
                //show(max_first_steps)//': take a shorter run, slower loads or softer springs, ' &
                //'or give dt')
    else if (.not. job%last_only .and. n/job%save_every > most) then
      call fail(status, status_input_error, 'save_every', 'save_every = ' &
                //show(job%save_every)//': would keep '//show(n/job%save_every) &
                //' states, must be at most '//show(most)//': take more steps between states ' &
                //'kept, a shorter run or keep = ''last''')
    end if
  end subroutine check_work

  !> The accuracy wanted, as it was given.
  function told(job)
    class(transient_job), intent(in) :: job
    character(len=:), allocatable :: told
    told = 'tolerance = '//show(job%tolerance)
    if (job%by_size()) told = 'tolerance = '//show(part_of_size)//' of the size of the motion'
    if (job%relative > 0.0_wp) told = 'rtol = '//show(job%relative)//', atol = ' &
                                      //show(job%tolerance)
  end function told

  !> Why halving the step led nowhere.
  function cause(job, last, change) result(text)
    class(transient_job), intent(in) :: job
    type(trajectory_type), intent(in) :: last
    real(wp), intent(in) :: change
    character(len=:), allocatable :: text
    real(wp) :: largest

    largest = maxval(abs(last%states))
    if (last%outcome /= run_completed) then
      text = 'the run is '//trim(run_names(last%outcome))//' at t = '//show(last%t_reached)
    else if (.not. job%by_size() .and. change < 1.0e-6_wp*largest &
             .and. job%tolerance + job%relative*largest < min_time_tolerance*largest) then
      text = 'the motion is as large as '//show(largest)//', and the tolerance is near its ' &
             //'rounding: give rtol'
    else
      text = 'the motion may be chaotic, unstable or too stiff: take a shorter run or a larger ' &
             //'tolerance'
    end if
  end function cause

  !> So many states between those of an accepted run that no peak between them is higher
  !! by more than `peaks` of the largest displacement: by a run in steps as short. States
  !! d apart let a displacement rise by at most |u''| d^2/8.
  subroutine fill_in(maker, job, n, factor, trajectory, change)
    class(run_maker), intent(in) :: maker
    class(transient_job), intent(in) :: job
    !> Steps of the first run, and how many times more those of the accepted one.
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor
    type(trajectory_type), intent(inout) :: trajectory
    !> Its error.
    real(wp), intent(inout) :: change
    type(trajectory_type) :: dense
    type(status_type) :: status
    real(wp) :: d, rise, largest
    integer :: i, m, parts

    if (job%save_every > 1 .or. job%last_only) return
    if (trajectory%outcome /= run_completed) then
      call fill_in_to_stop(maker, job, n, factor, trajectory, change)
      return
    end if
    m = size(trajectory%t)
    parts = 1
    d = trajectory%t(2) - trajectory%t(1)
    do i = 1, size(trajectory%states, 1), 2
      largest = maxval(abs(trajectory%states(i, :)))
      if (.not. largest > 0.0_wp) cycle
      ! Steps of a quarter period see curvatures smaller than they are.
      rise = 0.2_wp*d*maxval(abs(trajectory%states(i + 1, 2:) - trajectory%states(i + 1, :m - 1)))
      do while (parts < most_parts .and. rise > peaks*largest*real(parts, wp)**2)
        parts = 2*parts
      end do
    end do
    do while (parts > 1 .and. real(parts, wp)*m > most_states)
      parts = parts/2
    end do
    if (parts == 1) return
    m = max(factor, parts)
    call maker%make(job, n*m, m/parts, dense, status)
    if (status%failed()) return
    if (dense%outcome == trajectory%outcome) trajectory = dense
  end subroutine fill_in

  !> So many states of a run that stops that there is something to look at. Some of them are nearer
  !! to the stop than all that were compared: where a motion runs away errors grow with it, so
  !! they are compared with those of runs in shorter steps.
  subroutine fill_in_to_stop(maker, job, n, factor, trajectory, change)
    class(run_maker), intent(in) :: maker
    class(transient_job), intent(in) :: job
    !> As of `fill_in`.
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor
    type(trajectory_type), intent(inout) :: trajectory
    real(wp), intent(inout) :: change
    type(trajectory_type) :: more, finer
    type(status_type) :: status
    real(wp) :: error
    integer :: i, parts, steps

    parts = 1
    do while (parts < most_parts .and. parts*max(size(trajectory%t) - 1, 1) < states_at_stop)
      parts = 2*parts
    end do
    if (parts == 1) return
    steps = max(factor, parts)
    call maker%make(job, n*steps, steps/parts, finer, status)
    do i = 1, halvings_at_stop
      if (status%failed()) return
      more = finer
      steps = 2*steps
      call maker%make(job, n*steps, steps/parts, finer, status)
      if (status%failed()) return
      if (finer%outcome /= trajectory%outcome) return
      call maker%align(more, finer)
      error = change_of(more, finer)
      if (error > job%allowed_at_stop(finer)) cycle
      change = max(change, error)
      trajectory = finer
      return
    end do
  end subroutine fill_in_to_stop

end module viscovib_transient_job
