!> A motion in time as one job: from a start at rest or not, to an end, with the
!! step given or found.
module viscovib_transient_job
  use viscovib_checks, only: check_finite, check_positive
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_runs, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_method_catalogue, only: method_order, new_stepper, transient_methods
  use viscovib_reduction, only: state_mask
  use viscovib_simulate, only: run_completed, run_unphysical, simulate
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: transient_job, trajectory_type, run_maker
  public :: check_transient, check_times, run_transient, make_runs, plan_transient, plan_steps

  real(wp), parameter :: rounding = 1.0e-15_wp
  !> Halvings of the step before a tolerance is given up.
  integer, parameter :: min_halvings = 5, max_halvings = 12
  !> Bounds that stop a slip of the pen before it fills the memory or the year.
  real(wp), parameter :: max_steps = 1.0e12_wp, max_kept = 2.0e7_wp

  type :: transient_job
    !> (q_1, v_1, q_2, v_2, ...) at time 0.
    real(wp), allocatable :: initial(:)
    real(wp) :: t_end = 0.0_wp
    !> Step, shortened to fit; 0: found by `tolerance`.
    real(wp) :: dt = 0.0_wp
    !> Wanted error of the states; 0: to rounding, where dt is given.
    real(wp) :: tolerance = 1.0e-10_wp
    !> Place in `transient_methods`.
    integer :: method = 1
    !> Steps between states kept.
    integer :: save_every = 1
    !> Keep the state at the end alone.
    logical :: last_only = .false.
  end type transient_job

  type :: trajectory_type
    !> Times of the states kept, the start first; states, a column each.
    real(wp), allocatable :: t(:), states(:, :)
    integer :: outcome = run_completed
    real(wp) :: h = 0.0_wp, t_reached = 0.0_wp
    !> Largest change of a state kept when the step was halved; negative if the
    !! step was given.
    real(wp) :: error = -1.0_wp
    integer(i8) :: n_steps = 0
  contains
    procedure :: spread_out
  end type trajectory_type

  !> What makes runs of one motion, with any number of steps.
  type, abstract :: run_maker
  contains
    procedure(make_interface), deferred :: make
  end type run_maker

  abstract interface

    !> One run of n steps, keeping one state in save_every*thinning.
    subroutine make_interface(self, job, n, thinning, trajectory, status)
      import :: i8, run_maker, status_type, trajectory_type, transient_job
      class(run_maker), intent(in) :: self
      class(transient_job), intent(in) :: job
      integer(i8), intent(in) :: n
      integer, intent(in) :: thinning
      type(trajectory_type), intent(out) :: trajectory
      type(status_type), intent(out) :: status
    end subroutine make_interface

  end interface

  !> Runs of a system without memory.
  type, extends(run_maker) :: driven_runs
    class(driven_system_type), pointer :: system => null()
  contains
    procedure :: make => make_driven
  end type driven_runs

contains

  !> From the coordinates computed to all, the others at rest.
  subroutine spread_out(self, moved)
    class(trajectory_type), intent(inout) :: self
    !> Which were computed, shape (n_dof).
    logical, intent(in) :: moved(:)
    real(wp), allocatable :: states(:, :)
    integer :: i
    allocate (states(2*size(moved), size(self%t)))
    states = 0.0_wp
    states(pack([(i, i=1, size(states, 1))], state_mask(moved)), :) = self%states
    call move_alloc(states, self%states)
  end subroutine spread_out

  subroutine check_transient(job, system, status)
    class(transient_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    type(status_type), intent(out) :: status
    real(wp) :: q(size(job%initial)/2)
    integer :: i

    do i = 1, size(job%initial)
      call check_finite('initial', job%initial(i), status)
      if (status%failed()) return
    end do
    q = job%initial(1::2)
    if (.not. system%physical(q)) then
      call fail(status, status_input_error, 'initial', 'initial: this state is outside what the ' &
                //'equations describe (z must be greater than -1)')
      return
    end if
    call check_times(job, status)
  end subroutine check_transient

  !> End, step, tolerance and what is kept.
  subroutine check_times(job, status)
    class(transient_job), intent(in) :: job
    type(status_type), intent(out) :: status

    call check_positive('t_end', job%t_end, status)
    if (status%failed()) return
    call check_finite('dt', job%dt, status)
    if (status%failed()) return
    if (job%dt < 0.0_wp .or. job%dt > job%t_end) then
      call fail(status, status_input_error, 'dt', 'dt = '//show(job%dt)//': must be greater ' &
                //'than 0 and not exceed t_end = '//show(job%t_end)//', or 0 to be found')
      return
    end if
    call check_finite('tolerance', job%tolerance, status)
    if (status%failed()) return
    if (job%tolerance < 1.0e-13_wp .or. job%tolerance > 1.0_wp) then
      if (.not. (job%dt > 0.0_wp .and. job%tolerance == 0.0_wp)) then
        call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(job%tolerance) &
                  //': must be in [1e-13, 1]')
        return
      end if
    end if
    if (job%save_every < 1) then
      call fail(status, status_input_error, 'save_every', 'save_every = '//show(job%save_every) &
                //': must be at least 1')
      return
    end if
    if (job%dt > 0.0_wp) then
      if (job%t_end/job%dt > max_steps) then
        call fail(status, status_input_error, 'dt', 't_end/dt = '//show(job%t_end/job%dt) &
                  //': must be at most '//show(max_steps))
      else if (job%t_end/job%dt/job%save_every > max_kept) then
        call fail(status, status_input_error, 'save_every', 'save_every = ' &
                  //show(job%save_every)//': would keep more than '//show(max_kept)//' states')
      end if
    end if
  end subroutine check_times

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

  subroutine run_transient(job, system, fastest, trajectory, status)
    class(transient_job), intent(in) :: job
    class(driven_system_type), intent(in), target :: system
    !> Fastest frequency of the system and its loads: four steps a period to begin with.
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(driven_runs) :: maker

    maker%system => system
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
    integer :: i, factor

    n = first_steps(job, wanted)
    factor = 1
    if (job%dt > 0.0_wp) then
      call maker%make(job, int(n, i8), factor, trajectory, status)
      return
    end if
    call maker%make(job, int(n, i8), factor, coarse, status)
    if (status%failed()) return
    do i = 1, max_halvings
      factor = 2*factor
      change = huge(1.0_wp)
      if (n/job%save_every > max_kept .or. n*factor > max_steps) exit
      call maker%make(job, int(n, i8)*factor, factor, trajectory, status)
      if (status%failed()) return
      if (coarse%outcome == run_completed .and. trajectory%outcome == run_completed) then
        change = maxval(abs(trajectory%states - coarse%states))
        if (change <= job%tolerance) then
          trajectory%error = change
          return
        end if
      else if (coarse%outcome == run_unphysical .and. trajectory%outcome == run_unphysical) then
        return
      end if
      coarse = trajectory
      ! Halving is vain, for chaos or rounding, when two gain less than a digit.
      changes(i) = change
      if (i >= min_halvings .and. change > 0.1_wp*changes(max(i - 2, 1))) exit
    end do
    call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(job%tolerance) &
              //': not met with '//show(n*factor)//' steps (states still change by ' &
              //show(change)//' or the run fails); the motion may be chaotic: take a shorter run ' &
              //'or a larger tolerance')
  end subroutine make_runs

  subroutine make_driven(self, job, n, thinning, trajectory, status)
    class(driven_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: thinning
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    class(stepper_type), allocatable :: stepper
    real(wp), allocatable :: states(:, :)
    real(wp) :: no_times(0), no_states(size(job%initial), 0)
    integer(i8) :: every, kept, i

    if (counting) call count_up(counted_runs, 1)
    every = int(job%save_every, i8)*thinning
    trajectory%h = job%t_end/real(n, wp)
    call set_ok(status)
    call new_stepper(stepper, self%system, job%method, job%initial(1::2), job%initial(2::2), &
                     0.0_wp, trajectory%h, max(0.1_wp*job%tolerance, rounding))
    allocate (states(size(job%initial), merge(0_i8, n/every, job%last_only)))
    call simulate(stepper, self%system, 0_i8, n, every, no_times, states, no_states, &
                  trajectory%n_steps, trajectory%outcome)
    trajectory%t_reached = real(trajectory%n_steps, wp)*trajectory%h
    if (job%last_only) then
      trajectory%t = [trajectory%t_reached]
      allocate (trajectory%states(size(job%initial), 1))
      trajectory%states(1::2, 1) = stepper%q
      trajectory%states(2::2, 1) = stepper%v
      return
    end if
    kept = trajectory%n_steps/every
    allocate (trajectory%states(size(job%initial), kept + 1), trajectory%t(kept + 1))
    trajectory%states(:, 1) = job%initial
    trajectory%states(:, 2:) = states(:, :kept)
    do i = 0, kept
      trajectory%t(i + 1) = real(every*i, wp)*trajectory%h
    end do
  end subroutine make_driven

  !> What will be computed and what is skipped, with the reasons.
  function plan_transient(job) result(text)
    class(transient_job), intent(in) :: job
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')

    text = 'computes: motion to t = '//show(job%t_end)//' by ' &
           //trim(transient_methods(job%method))//', order '//show(method_order(job%method))//nl &
           //plan_steps(job)
  end function plan_transient

  !> The lines about steps and what is kept.
  function plan_steps(job) result(text)
    class(transient_job), intent(in) :: job
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')

    if (job%dt > 0.0_wp) then
      text = 'computes: '//show(first_steps(job, 0.0_wp))//' equal steps'//nl &
             //'skips: estimate of the error (the step is given)'//nl
    else
      text = 'computes: the step, halved until the states kept change by no more than ' &
             //show(job%tolerance)//nl
    end if
    if (job%last_only) text = text//'skips: storing states on the way (only the last is ' &
                              //'wanted)'//nl
    if (job%save_every > 1) text = text//'skips: storing all but one state in ' &
                                   //show(job%save_every)//' (the others are not wanted)'//nl
  end function plan_steps

end module viscovib_transient_job
