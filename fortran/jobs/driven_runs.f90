!> Runs of a system without memory, in any steps.
module viscovib_driven_runs
  use viscovib_counters, only: count_up, counted_runs, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_run_maker, only: run_maker, transient_job
  use viscovib_simulate, only: simulate
  use viscovib_status, only: set_ok, status_type
  use viscovib_stepper, only: stepper_type
  use viscovib_trajectory, only: shaken, trajectory_type
  use viscovib_watch, only: new_watch, renumbered
  implicit none
  private

  public :: driven_runs

  !> Runs of a system without memory.
  type, extends(run_maker) :: driven_runs
    class(driven_system_type), pointer :: system => null()
    !> One whose numbers are other by as much as the part; null: not known.
    class(driven_system_type), pointer :: other => null()
    real(wp) :: part = shaken
  contains
    procedure :: make => make_driven
    procedure :: make_shaken => make_other
    procedure :: goes_in_parts
  end type driven_runs

contains

  !> As soon as one run has met a thin layer.
  logical function goes_in_parts(self)
    class(driven_runs), intent(in) :: self
    goes_in_parts = self%system%in_parts
  end function goes_in_parts

  subroutine make_other(self, job, n, factor, sign, trajectory, status)
    class(driven_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, sign
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(driven_runs) :: maker
    class(transient_job), allocatable :: begun
    call set_ok(status)
    ! Runs before and after thin layers are met are not in the same parts of steps.
    if (.not. associated(self%other) .or. self%system%in_parts) return
    self%other%longest = self%system%longest
    maker%system => self%other
    allocate (begun, source=job)
    begun%initial = job%initial*(1.0_wp + sign*self%part)
    call maker%make(begun, n, factor, 1, trajectory, status)
  end subroutine make_other

  subroutine make_driven(self, job, n, factor, parts, trajectory, status)
    class(driven_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, parts
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    class(stepper_type), allocatable :: stepper
    real(wp), allocatable :: states(:, :)
    real(wp) :: no_times(0), no_states(size(job%initial), 0)
    real(wp), dimension(self%system%n_dof) :: q, v
    integer(i8) :: every, kept, i, steps
    integer :: j, m, n_reached

    m = size(job%initial)/2
    if (allocated(job%watched)) then
      allocate (trajectory%watch)
      call new_watch(trajectory%watch, renumbered(job%watched, m, [(j, j=1, self%system%n_dof)]))
    end if
    if (counting) call count_up(counted_runs, 1)
    every = job%steps_apart(n, factor, parts)
    steps = n*factor
    trajectory%h = job%t_end/real(steps, wp)
    trajectory%keeps_energy = self%system%keeps_energy
    call set_ok(status)
    call self%system%start(0.0_wp, job%initial(1::2), job%initial(2::2), q, v)
    call new_stepper(stepper, self%system, job%method, q, v, 0.0_wp, trajectory%h, job%solved())
    allocate (states(size(job%initial), steps/every))
    self%system%longest = max(self%system%longest, trajectory%h)
    self%system%thin = trajectory%h/self%system%longest
    call self%system%begin_anew()
    call simulate(stepper, self%system, 0_i8, steps, every, no_times, states, no_states, &
                  trajectory%n_steps, n_reached, trajectory%t_reached, trajectory%outcome, &
                  watch=trajectory%watch)
    trajectory%last = job%initial
    q = stepper%q
    v = stepper%v
    call self%system%add_base(trajectory%t_reached, q, v)
    trajectory%last(1::2) = q(:m)
    trajectory%last(2::2) = v(:m)
    if (trajectory%n_steps == steps) trajectory%t_reached = job%t_end
    if (job%last_only) then
      trajectory%t = [trajectory%t_reached]
      allocate (trajectory%states(size(job%initial), 1))
      trajectory%states(:, 1) = trajectory%last
      allocate (trajectory%looks(size(job%initial), 1 + trajectory%n_steps/every))
      trajectory%looks(:, 1) = job%initial
      trajectory%looks(:, 2:) = states(:, :trajectory%n_steps/every)
      return
    end if
    kept = trajectory%n_steps/every
    allocate (trajectory%states(size(job%initial), kept + 1), trajectory%t(kept + 1))
    trajectory%states(:, 1) = job%initial
    trajectory%states(:, 2:) = states(:, :kept)
    do i = 0, kept
      trajectory%t(i + 1) = real(every*i, wp)*trajectory%h
    end do
    ! The product is rounded.
    if (every*kept == steps) trajectory%t(kept + 1) = job%t_end
  end subroutine make_driven

end module viscovib_driven_runs
