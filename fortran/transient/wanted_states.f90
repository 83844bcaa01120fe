! Optimize: -O1
!> States of a run at requested times, each by a separate step from the start of the step.
module viscovib_wanted_states
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stops, only: find_stop, in_range, stop_type
  use viscovib_time_run, only: run_completed, time_run
  implicit none
  private

  public :: keep_along, keep_between

contains

  !> States at the requested times from the present one up to the end of the step, or up to
  !! the first one that cannot be reached: the run is `lost`.
  subroutine keep_between(run, method, system, now)
    class(time_run), intent(inout) :: run
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: now
    real(wp) :: q(size(method%q)), v(size(method%v)), a(size(method%q)), ahead, next
    real(wp) :: force(system%n_laws())
    type(stop_type) :: stop
    integer :: n
    logical :: made

    do while (run%n_reached < size(run%times))
      next = run%times(run%n_reached + 1)
      ahead = next - now
      ! A time that differs from the end of the step by rounding only is the end.
      if (ahead >= method%h - 4.0_wp*spacing(next)) return
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
          run%lost = stop%outcome /= run_completed
          if (run%lost) return
        end if
      end if
      if (allocated(run%accelerations)) then
        n = system%n_dof
        call system%law_forces(next, q(:n), v(:n), a(:n), force)
        n = n - system%n_hidden
        run%accelerations(:, run%n_reached + 1) = [a(:n), force]
      end if
      call system%add_base(next, q, v)
      call run%keep_wanted(q, v)
    end do
  end subroutine keep_between

  !> States at the wanted times before `until`, by the motion inside a step.
  subroutine keep_along(run, path, until)
    class(time_run), intent(inout) :: run
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: until
    real(wp) :: t(1), q(1, size(path%q, 2)), v(1, size(path%q, 2))
    do while (run%n_reached < size(run%times))
      associate (next => run%times(run%n_reached + 1))
        if (next >= until) return
        call path%at([max(0.0_wp, next - path%start)/path%h], t, q, v)
      end associate
      call run%keep_wanted(q(1, :), v(1, :))
    end do
  end subroutine keep_along

end module viscovib_wanted_states
