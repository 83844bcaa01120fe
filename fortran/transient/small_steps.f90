!> States inside a step of the run that small steps replace, as near
!! the pivot of a pendulum: events and states at requested times, from each of the small steps.
module viscovib_small_steps
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_step_path, only: step_path
  use viscovib_stops, only: find_stop, run_event, step_visitor, stop_type
  use viscovib_wanted_states, only: wanted_states
  use viscovib_watch, only: event_point_type, watch_type
  implicit none
  private

  public :: note_small_steps

  type, extends(step_visitor) :: note_taker
    type(watch_type), pointer :: watch => null()
    type(wanted_states), pointer :: wanted => null()
    !> An event has ended the run: its time and state.
    logical :: ended = .false.
    real(wp) :: t = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
  contains
    procedure :: visit
  end type note_taker

contains

  !> Repeat the steps of `find_stop` from (q, v) and store the requested data. An event that
  !! ends the run is its stop.
  subroutine note_small_steps(system, q, v, start, h, watch, wanted, stop)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(:), v(:), start, h
    type(watch_type), intent(inout), target :: watch
    type(wanted_states), intent(inout), target :: wanted
    !> Result of `find_stop`, other than "step too large".
    type(stop_type), intent(inout) :: stop
    type(note_taker) :: notes
    type(stop_type) :: again

    if (watch%is_idle() .and. .not. wanted%within(start, h)) return
    notes%watch => watch
    notes%wanted => wanted
    call find_stop(system, size(q), 1, spread(system%drives, 1, n_lanes), q, v, start, h, again, &
                   notes)
    if (.not. notes%ended) return
    stop%outcome = run_event
    stop%ahead = notes%t - start
    stop%q = notes%q
    stop%v = notes%v
  end subroutine note_small_steps

  !> Store events and requested states of one small step.
  subroutine visit(self, path)
    class(note_taker), intent(inout) :: self
    type(step_path), intent(in) :: path
    type(event_point_type), allocatable :: found(:)
    real(wp) :: t(1), q(1, size(path%q, 2)), v(1, size(path%q, 2)), until
    integer :: i

    if (self%ended) return
    call self%watch%extremes%take(path)
    call self%watch%look(path, .false., found)
    until = path%start + path%h
    do i = 1, size(found)
      call path%at([found(i)%place], t, q, v)
      call self%watch%keep(found(i), t(1), q(1, :), v(1, :), path%acceleration_at(found(i)%place))
      self%ended = self%watch%terminal(found(i)%which)
      if (.not. self%ended) cycle
      self%t = t(1)
      self%q = q(1, :)
      self%v = v(1, :)
      until = t(1)
    end do
    call self%wanted%keep_along(path, until)
  end subroutine visit

end module viscovib_small_steps
