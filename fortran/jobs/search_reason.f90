!> The reason why a search for the step of a motion found none, as text.
module viscovib_search_reason
  use viscovib_kinds, only: i8, wp
  use viscovib_motion_request, only: transient_job
  use viscovib_rounded, only: brief
  use viscovib_status, only: show
  use viscovib_step_search, only: max_steps, search_type, step_grown, step_in_layer, step_too_many
  use viscovib_time_run, only: run_completed, run_event, run_names
  use viscovib_trajectory, only: trajectory_type
  implicit none
  private

  public :: find_reason

  !> Bound of kept states, which rejects typing errors that would fill the memory.
  real(wp), parameter, public :: max_kept = 2.0e7_wp
  !> Relative rounding error of a step; number of states within which growing errors are still
  !! small.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: few = 20
  !> A change between two states by this factor is sudden.
  real(wp), parameter :: suddenly = 100.0_wp
  !> A difference that is larger later by this factor may be that of a chaotic motion.
  real(wp), parameter :: grows = 1.0e3_wp
  character(len=*), parameter :: unstable = 'the motion is chaotic or unstable, use '

contains

  !> The outcome, such as "not met with 4096 steps", and its cause with advice.
  subroutine find_reason(job, n, search, outcome, cause, place)
    class(transient_job), intent(in) :: job
    !> Steps of the first run.
    integer(i8), intent(in) :: n
    type(search_type), intent(in) :: search
    character(len=:), allocatable, intent(out) :: outcome, cause
    !> Index of the kept state after which two runs suddenly differ; 0: they do not.
    integer, intent(out) :: place
    real(wp) :: steps

    place = 0
    steps = real(n, wp)*search%factor
    outcome = 'not met'
    associate (run => search%run)
      if (search%verdict == step_grown) then
        if (.not. search%grown < huge(1.0_wp)) then
          cause = 'with numbers of the system changed by rounding errors the run ends ' &
                  //'differently: '//unstable//'a shorter run or a larger tolerance'
        else if (run%outcome == run_event) then
          cause = 'rounding causes an error of '//rough(search%grown)//' of the event that ends ' &
                  //'the run at t = '//brief(run%t_reached)//': the event is close ' &
                  //'to grazing, or '//unstable//'a larger tolerance'
        else
          cause = 'the motion amplifies rounding errors of the numbers of the system ' &
                  //rough(search%grown/epsilon(1.0_wp))//' times until t = ' &
                  //brief(run%t_reached)//', to an error of ' &
                  //rough(search%grown)//': '//unstable//'a shorter run or a larger tolerance'
        end if
      else if (search%verdict == step_in_layer) then
        outcome = outcome//' with '//show(steps)//' steps'
        cause = 'a law changes in a layer thinner than a step (use a smaller dt, or a wider ' &
                //'layer)'
      else if (search%verdict == step_too_many .or. .not. allocated(search%coarse%states)) then
        cause = show(steps)//' steps, and twice as many for the error estimate, are too ' &
                //'many (at most '//show(max_steps)//', and '//show(max_kept)//' states kept): ' &
                //'use a shorter run or give dt'
      else
        outcome = outcome//' with '//show(steps)//' steps (runs with different step sizes end ' &
                  //'differently)'
        if (search%change < huge(1.0_wp)) outcome = 'not met with '//show(steps) &
                                                    //' steps (states still change by ' &
                                                    //rough(search%change)//')'
        call compare_runs(job, search%coarse, run, cause, place)
      end if
    end associate
  end subroutine find_reason

  !> Why halving the step size does not help.
  subroutine compare_runs(job, coarse, fine, cause, place)
    class(transient_job), intent(in) :: job
    type(trajectory_type), intent(in) :: coarse, fine
    character(len=:), allocatable, intent(out) :: cause
    integer, intent(out) :: place
    real(wp) :: allowed(size(fine%states, 1)), part(size(fine%states, 2)), extent
    integer :: worst

    place = 0
    if (fine%outcome /= run_completed) then
      cause = ending(fine)
    else if (coarse%outcome /= run_completed) then
      cause = ending(coarse)
    else if (any(shape(coarse%states) /= shape(fine%states))) then
      cause = 'two runs with different step sizes end at different times'
    else
      allowed = job%allowed(fine)
      worst = maxloc(maxval(abs(fine%states - coarse%states), 2)/max(allowed, 1.0e-300_wp), 1)
      part = abs(fine%states(worst, :) - coarse%states(worst, :))
      extent = maxval(abs(fine%states(worst, :)))
      if (allowed(worst) < 1.0e-13_wp*extent .and. maxval(part) < 1.0e-6_wp*extent) then
        cause = 'the size of the motion is '//rough(extent)//', and the tolerance is ' &
                //rough(allowed(worst)/extent)//' of it, close to the rounding error: give rtol'
      else if (.not. any(part > allowed(worst))) then
        cause = 'two runs differ before the end and agree at the end by chance, as after a ' &
                //'chaotic transient: use a shorter run, or keep all states'
      else
        call find_growth(fine, part, allowed(worst), extent, cause, place)
      end if
    end if
  end subroutine compare_runs

  !> "the run is 'diverged' at t = 3.2, in steps of ..."
  function ending(run) result(text)
    type(trajectory_type), intent(in) :: run
    character(len=:), allocatable :: text
    text = "the run is '"//trim(run_names(run%outcome))//"' at t = " &
           //brief(run%t_reached)//', in steps of '//rough(run%h)//' (largest value ' &
           //rough(maxval(abs(run%states)))//')'
  end function ending

  !> The cause by the course of the difference of two runs.
  subroutine find_growth(fine, part, allowed, extent, cause, place)
    type(trajectory_type), intent(in) :: fine
    !> Difference at each state, its allowed size, and the size of the motion.
    real(wp), intent(in) :: part(:), allowed, extent
    character(len=:), allocatable, intent(out) :: cause
    integer, intent(out) :: place
    real(wp) :: alike, grown, most, next, steps
    integer :: first, half, i, n

    n = size(part)
    ! Unstable errors grow over many steps; a kink or jump causes an error within one step.
    place = 0
    most = max(part(1), 1.0e-3_wp*allowed)
    do i = 1, n - 1
      next = max(most, part(i + 1))
      if (next > suddenly*most) then
        place = i
        cause = 'two runs agree to t = '//brief(fine%t(i))//' and differ suddenly by ' &
                //'t = '//brief(fine%t(i + 1))//': a force has a jump or corner at ' &
                //'which no step ends, or changes too fast for the steps; use a larger ' &
                //'tolerance or a smaller dt'
        return
      end if
      most = next
    end do
    steps = fine%t_reached/fine%h
    if (maxval(part) <= min(rounding*steps*extent, 1.0e-8_wp*extent)) then
      cause = 'the rounding error is about '//rough(maxval(part))//' for a motion of size ' &
              //rough(extent)//' in '//show(anint(steps))//' steps: use a larger tolerance or a ' &
              //'shorter run'
      return
    end if
    ! In a long run unstable errors may grow early, but not within a few steps.
    alike = min(0.05_wp*n, real(few, wp))
    first = findloc(part > allowed, .true., 1)
    half = (first - 1)/2 + 1
    if (first - 1 > alike .and. 2*count(part(:half) < 0.1_wp*allowed) > half) then
      grown = maxval(part(first:))/max(maxval(part(:half)), 1.0e-300_wp)
      cause = 'two runs agree to t = '//brief(fine%t(first - 1))//' and differ ' &
              //rough(grown)//' times as much after it: '//unstable//'a shorter run or a larger ' &
              //'tolerance'
    else if (n <= few .or. maxval(part) > grows*maxval(part(:min(few, n)))) then
      ! With so few states, or if the difference is too large early and grows later, the source of
      ! errors is unknown.
      cause = 'the fastest motion is not resolved, or the motion is chaotic or unstable: use a ' &
              //'larger tolerance, a smaller dt or a shorter run'
    else
      cause = 'the fastest motion is not resolved (it is too stiff for this method): use a ' &
              //'larger tolerance or a smaller dt'
    end if
  end subroutine find_growth

  !> Two digits, such as 1.2e-05.
  pure function rough(x) result(text)
    real(wp), intent(in) :: x
    character(len=:), allocatable :: text
    character(len=12) :: buffer
    integer :: i
    if (x >= 1.0e-99_wp .and. x < 1.0e99_wp) then
      write (buffer, '(es8.1e2)') x
    else
      write (buffer, '(es9.1e3)') x
    end if
    i = index(buffer, 'E')
    if (i > 0) buffer(i:i) = 'e'
    text = trim(adjustl(buffer))
  end function rough

end module viscovib_search_reason
