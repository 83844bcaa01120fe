!> States of a run at requested times, each by a separate step from the start of the step.
module viscovib_wanted_states
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stops, only: find_stop, in_range, run_completed, stop_type
  implicit none
  private

  public :: wanted_states

  type :: wanted_states
    !> Ascending; number of times reached, and the states there, shape (2 n_dof, n).
    real(wp), allocatable :: times(:), states(:, :)
    !> Accelerations there, relative to the base, then forces of laws; not allocated: not wanted.
    real(wp), allocatable :: accelerations(:, :)
    integer :: n_reached = 0
    !> True if the motion up to one of them could not be computed.
    logical :: lost = .false.
  contains
    procedure :: begin
    procedure :: within
    procedure :: keep_between
    procedure :: keep_along
  end type wanted_states

contains

  !> None is reached yet.
  subroutine begin(self, times, n_states, system, accelerates)
    class(wanted_states), intent(inout) :: self
    real(wp), intent(in) :: times(:)
    integer, intent(in) :: n_states
    class(driven_system_type), intent(in) :: system
    logical, intent(in) :: accelerates
    integer :: n
    self%times = times
    allocate (self%states(n_states, size(times)))
    n = system%n_dof - system%n_hidden + system%n_laws()
    if (accelerates) allocate (self%accelerations(n, size(times)), source=0.0_wp)
  end subroutine begin

  !> Whether the next is in a step from a time on.
  pure logical function within(self, from, h)
    class(wanted_states), intent(in) :: self
    real(wp), intent(in) :: from, h
    within = .false.
    if (self%n_reached < size(self%times)) within = self%times(self%n_reached + 1) < from + h
  end function within

  !> States at the requested times from the present one up to the end of the step, or up to
  !! the first one that cannot be reached: `lost`.
  subroutine keep_between(self, method, system, now)
    class(wanted_states), intent(inout) :: self
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: now
    real(wp) :: q(size(method%q)), v(size(method%v)), a(size(method%q)), ahead
    real(wp) :: force(system%n_laws())
    type(stop_type) :: stop
    integer :: n
    logical :: made

    do while (self%n_reached < size(self%times))
      ahead = self%times(self%n_reached + 1) - now
      if (ahead >= method%h*(1.0_wp - 4.0_wp*epsilon(1.0_wp))) return
      q = method%q
      v = method%v
      if (ahead > 4.0_wp*spacing(now)) then
        call method%look_ahead(system, ahead, q, v, made)
        if (made) made = in_range(system, q, v)
        if (.not. made) then
          call find_stop(system, size(q), 1, spread(system%drives, 1, n_lanes), method%q, &
                         method%v, now, ahead, stop)
          q = stop%q
          v = stop%v
          ! If the motion stops before, the step itself reports it.
          self%lost = stop%outcome /= run_completed
          if (self%lost) return
        end if
      end if
      self%n_reached = self%n_reached + 1
      if (counting) call count_up(counted_states, 1)
      if (allocated(self%accelerations)) then
        n = system%n_dof
        call system%law_forces(self%times(self%n_reached), q(:n), v(:n), a(:n), force)
        n = n - system%n_hidden
        self%accelerations(:, self%n_reached) = [a(:n), force]
      end if
      call system%add_base(self%times(self%n_reached), q, v)
      self%states(1::2, self%n_reached) = q
      self%states(2::2, self%n_reached) = v
    end do
  end subroutine keep_between

  !> States at the wanted times before `until`, by the motion inside a step.
  subroutine keep_along(self, path, until)
    class(wanted_states), intent(inout) :: self
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: until
    real(wp) :: t(1), q(1, size(path%q, 2)), v(1, size(path%q, 2))
    do while (self%n_reached < size(self%times))
      associate (next => self%times(self%n_reached + 1))
        if (next >= until) return
        call path%at([max(0.0_wp, next - path%start)/path%h], t, q, v)
      end associate
      self%n_reached = self%n_reached + 1
      if (counting) call count_up(counted_states, 1)
      self%states(1::2, self%n_reached) = q(1, :)
      self%states(2::2, self%n_reached) = v(1, :)
    end do
  end subroutine keep_along

end module viscovib_wanted_states
