! Flat routine over the motion of a structure in time, for f2py.

!> A run from time 0 in steps h, as `mount_simulate` has it, of a structure whose linear rest are
!! n sections q'' + rates q' + squares q = pushes. `elements`: the vector of a polynomial system in
!! the deflections seen^T q, its mass and damping idle; its forces act on the modes by -pushed.
!! The load is Im sum_k waves(:,k) exp(i frequencies(k) t) on the modes, and columns of cubics
!! between breaks (n_breaks = 1: none), which push them by `patterns`. What is kept are coordinates
!! shown^T q and their velocities, of a body whose base moves them by `direction`, and the modes by
!! `inner` (n_base = 1: it has no table). The start is relative to the base. With resume = 2 loads
!! are others than before; the base jumps back by `kick`, its displacement and its velocity. What
!! has no real modes, as `viscovib_pole_maps` takes it, are poles, of conjugates one each (a single
!! one of 0: none), the last n_at_once of them follow their forces at once; by_base: by a jump of
!! the base, and of its velocity. phased: as `phase_errors` has it of what is kept.
subroutine structure_simulate(elements, n_elements, squares, rates, n, seen, pushed, n_seen, &
                              poles, left, right, n_right, sine, cosine, by_base, n_poles, &
                              shown_left, &
                              patterns, n_columns, frequencies, waves, n_frequencies, breaks, &
                              pieces, n_breaks, shown, n_shown, direction, inner, &
                              base_waves, base_breaks, base_pieces, n_base, ends, made_by, &
                              n_ends, s, past, held, before, moved, n_before, start, start_rates, &
                              start_others, kick, h, shortest, kinks, t_end, tolerance, &
                              first, n_steps, &
                              save_every, resume, memory, n_memory, times, n_times, n_states, &
                              watched, n_watch, sides, n_sides, most, n_at_once, states, &
                              at_times, last, kept, n_kept, n_done, n_reached, t_reached, ended, &
                              n_iterations, resolution, reason, found, n_found, too_long, phased, &
                              status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_base_motion, only: base_motion_type
  use viscovib_binding_tools, only: make_base, report
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_law_layers, only: unseen_by_node
  use viscovib_march, only: begun, step_too_large
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_modal_maps, only: sections_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: status_type
  use viscovib_structure_march, only: new_structure_march, structure_march_type
  use viscovib_system_vector, only: polynomial_from_vector
  use viscovib_time_load, only: time_load_type
  use viscovib_watch, only: new_watch, watch_type
  implicit none
  integer(c_int), intent(in) :: n_elements, n, n_seen, n_columns, n_frequencies, n_breaks, n_shown
  integer(c_int), intent(in) :: n_poles, n_right, n_base, n_ends, s, past, n_before, kinks, resume
  integer(c_int), intent(in) :: n_memory, n_times, n_states, n_watch, n_sides, most, n_at_once
  integer(c_long), intent(in) :: first, n_steps, save_every, made_by(n_ends)
  real(c_double), intent(in) :: elements(n_elements), squares(n), rates(n), seen(n, n_seen)
  real(c_double), intent(in) :: pushed(n, n_seen), patterns(n, n_columns), breaks(n_breaks)
  real(c_double), intent(in) :: frequencies(n_frequencies), pieces(n_columns, 4, n_breaks)
  complex(c_double_complex), intent(in) :: waves(n, n_frequencies), base_waves(n_frequencies)
  real(c_double), intent(in) :: shown(n, n_shown), direction(n_shown), inner(n)
  complex(c_double_complex), intent(in) :: poles(n_poles), left(n_poles, n_seen)
  complex(c_double_complex), intent(in), dimension(n_poles, n_frequencies) :: sine, cosine
  complex(c_double_complex), intent(in) :: right(n_poles, n_right), by_base(n_poles, 2)
  complex(c_double_complex), intent(in) :: shown_left(n_poles, n_shown), start_others(n_poles)
  real(c_double), intent(in) :: base_breaks(n_base), base_pieces(4, n_base), ends(n_ends)
  real(c_double), intent(in) :: held(n_seen), before(n_before), moved(n_seen, n_before)
  real(c_double), intent(in) :: start(n), start_rates(n), kick(2), h, shortest, t_end, tolerance
  real(c_double), intent(in) :: memory(n_memory), times(n_times)
  real(c_double), intent(out) :: states(2*n_shown, n_states), at_times(2*n_shown, n_times)
  real(c_double), intent(out) :: last(2*n_shown), kept(n_memory), resolution, t_reached, too_long
  real(c_double), intent(out) :: phased(2*n_shown)
  integer(c_long), intent(out) :: n_done
  real(c_double), intent(in) :: watched(n_watch)
  integer(c_int), intent(inout) :: sides(n_sides)
  real(c_double), intent(out) :: found(3*n_shown + 4, most)
  integer(c_int), intent(out) :: n_kept, n_reached, ended, n_iterations, reason, n_found, status
  !f2py threadsafe
  type(polynomial_type) :: system
  type(structure_march_type) :: run
  type(sections_type) :: sections
  type(time_load_type) :: load
  type(base_motion_type) :: base
  type(mesh_type) :: mesh
  type(watch_type) :: watch
  type(status_type) :: outcome
  real(c_double), allocatable :: u(:), v(:)
  integer, allocatable :: some(:)
  integer :: columns, k, piece, used
  ! Absent where not allocated.
  real(c_double), allocatable :: least
  logical, allocatable :: with_kinks
  logical :: made

  kept = 0.0_c_double
  last = 0.0_c_double
  states = 0.0_c_double
  at_times = 0.0_c_double
  n_kept = 0
  n_done = 0
  n_reached = 0
  t_reached = 0.0_c_double
  n_iterations = 0
  resolution = 0.0_c_double
  ended = 0
  ! Of `found`, columns beyond n_found are not set: it is larger than all else here.
  n_found = 0
  too_long = 0.0_c_double
  phased = 0.0_c_double
  reason = begun
  call polynomial_from_vector(system, elements, outcome)
  if (.not. outcome%failed()) then
    sections%squares = squares
    sections%rates = rates
    sections%seen = seen
    columns = merge(n_columns, 0_c_int, n_breaks > 1)
    allocate (sections%pushed(n, n_seen + columns))
    sections%pushed(:, :n_seen) = pushed
    sections%pushed(:, n_seen + 1:) = patterns(:, :columns)
    some = pack([(k, k=1, n_frequencies)], [(any(abs(waves(:, k)) > 0.0_c_double) &
                                             .or. any(abs(sine(:, k)) > 0.0_c_double) &
                                             .or. any(abs(cosine(:, k)) > 0.0_c_double), &
                                             k=1, n_frequencies)])
    sections%frequencies = frequencies(some)
    sections%waves = waves(:, some)
    sections%inner = inner
    used = merge(0_c_int, n_poles, n_poles == 1 .and. n_at_once == 0 &
                 .and. .not. abs(poles(1)) > 0.0_c_double)
    sections%others%n_at_once = n_at_once
    sections%others%poles = poles(:used)
    sections%others%left = left(:used, :)
    sections%others%right = right(:used, :n_seen + columns)
    sections%others%sine = sine(:used, some)
    sections%others%cosine = cosine(:used, some)
    sections%others%by_base = by_base(:used, 1)
    sections%others%by_base_rate = by_base(:used, 2)
    allocate (load%frequencies(0), load%amplitudes(columns, 0))
    load%breaks = breaks
    load%pieces = pieces(:columns, :, :)
    call make_base(base, direction, frequencies, spread(base_waves, 1, 1), base_breaks, &
                   spread(base_pieces, 2, 1))
    call new_mesh(mesh, h, ends, made_by)
    piece = mesh%piece_of(first)
    call base%enter(mesh%beginning(piece), mesh%ends(piece))
    if (shortest > 0.0_c_double) then
      least = shortest
      with_kinks = kinks /= 0
    end if
    call new_structure_march(run, system, sections, shown, shown_left(:used, :), load, s, past, &
                             held, [start, real(start_others(:used))], &
                             [start_rates, aimag(start_others(:used))], mesh%h(piece), t_end, &
                             tolerance, reason, before, moved, least, with_kinks)
    made = .true.
    if (reason == begun .and. resume /= 0) then
      call run%load_memory(memory, resume == 2)
      if (resume == 2) then
        call run%kick(base, kick(1:1), kick(2:2))
        call run%get_state(u, v)
        call run%take_up(system, load, mesh%start_of(first), u, v, made)
      end if
      if (.not. made) reason = step_too_large
    end if
    if (reason == begun) then
      call new_watch(watch, watched, sides, run%n_observed())
      call run_hereditary(run, system, load, base, first, n_steps, save_every, times, states, &
                          at_times, n_done, n_reached, t_reached, ended, mesh, resume == 2, &
                          watch, too_long)
      call watch%hand_over(sides, found, n_found)
      if (allocated(u)) deallocate (u, v)
      allocate (u(n_shown), v(n_shown))
      call run%observe(u, v)
      call base%add_to(t_reached, u, v)
      last(1::2) = u
      last(2::2) = v
      n_iterations = run%equations%n_iterations
      resolution = run%resolution()
      phased = run%phase_errors()
      n_kept = run%memory_size()
      if (n_kept <= n_memory) kept(:n_kept) = run%save_memory()
    end if
  end if
  too_long = too_long/(unseen_by_node*s)
  call report(outcome, status)

end subroutine structure_simulate
