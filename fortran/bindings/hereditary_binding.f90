! Flat routines over motion with memory, for f2py. The system is given as in
! mount_binding.

!> A run from time 0 in steps h; first steps are done already. The load is
!! Im sum_k amplitudes(:,k) exp(i frequencies(k) t) and cubics between breaks. Steps end
!! at `ends`, `made_by` of them by each; if none of these is greater than 0 they are equal.
!! Loads may have corners, kinks /= 0: the base too, no step of this or a later run being
!! shorter than `shortest`; or not, with shortest = 0. s nodes a step; past: 1
!! exponentials, 2 step by step; held: the displacement for all t < 0, or before the first
!! of the times `before` with displacements `moved`, ascending to 0. The base moves by
!! waves(k) at frequencies(k), and by the cubics between base_breaks, the last for ever
!! (n_base = 1: no cubics); of this its acceleration is in the load already, and states
!! are those of the body; n_waves = 1: along the direction of the system, n_waves = n_dof: each
!! coordinate by its own. With resume = 1, `memory` is what an earlier call returned in
!! `kept`(:n_kept); if n_kept > n_memory there was no room for it. With resume = 2 load and
!! base are others than then, and `initial` counts. resolution: largest last Legendre
!! coefficient of a displacement on a step, relative to its largest value. reason /= 0: no
!! run, see `viscovib_hereditary`. Only coordinates with moves /= 0 are
!! computed, as `moving_coordinates` tells; the others stay at rest. too_long: how many times as
!! long steps are as those whose nodes see every thin layer of a law.
subroutine mount_simulate(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                          frequencies, amplitudes, n_dof, n_frequencies, breaks, pieces, &
                          n_breaks, waves, n_waves, base_breaks, base_pieces, n_base, ends, &
                          made_by, n_ends, s, past, held, before, moved, n_before, moves, initial, &
                          h, shortest, kinks, t_end, tolerance, first, n_steps, save_every, &
                          resume, memory, n_memory, times, n_times, n_columns, watched, &
                          n_watch, sides, n_sides, most, states, at_times, last, kept, n_kept, &
                          n_done, n_reached, t_reached, ended, n_iterations, resolution, reason, &
                          found, n_found, too_long, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_binding_tools, only: keep_moving, make_base, make_system, report
  use viscovib_base_motion, only: base_motion_type
  use viscovib_hereditary, only: begun, hereditary_type, new_hereditary, step_too_large
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_law_layers, only: unseen_by_node
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_oscillator, only: oscillator_type
  use viscovib_reduction, only: state_mask
  use viscovib_status, only: status_type
  use viscovib_time_load, only: time_load_type
  use viscovib_watch, only: new_watch, watch_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_dof, n_frequencies
  integer(c_int), intent(in) :: n_ends, n_breaks, s, past, resume, n_before, n_memory, n_times
  integer(c_int), intent(in) :: n_columns, moves(n_dof), n_base, kinks, n_waves
  integer(c_long), intent(in) :: first, n_steps, save_every, made_by(n_ends)
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), ends(n_ends)
  real(c_double), intent(in) :: frequencies(n_frequencies), breaks(n_breaks)
  complex(c_double_complex), intent(in) :: amplitudes(n_dof, n_frequencies)
  complex(c_double_complex), intent(in) :: waves(n_waves, n_frequencies)
  real(c_double), intent(in) :: base_breaks(n_base), base_pieces(4, n_waves, n_base)
  real(c_double), intent(in) :: pieces(n_dof, 4, n_breaks), held(n_dof), initial(2*n_dof)
  real(c_double), intent(in) :: before(n_before), moved(n_dof, n_before)
  real(c_double), intent(in) :: h, shortest, t_end, tolerance
  real(c_double), intent(in) :: memory(n_memory), times(n_times)
  real(c_double), intent(out) :: states(2*n_dof, n_columns), at_times(2*n_dof, n_times)
  real(c_double), intent(out) :: last(2*n_dof), kept(n_memory), resolution, t_reached, too_long
  integer(c_long), intent(out) :: n_done
  integer(c_int), intent(in) :: n_watch, n_sides, most
  real(c_double), intent(in) :: watched(n_watch)
  integer(c_int), intent(inout) :: sides(n_sides)
  real(c_double), intent(out) :: found(3*n_dof + 4, most)
  integer(c_int), intent(out) :: n_kept, n_reached, ended, n_iterations, reason, n_found, status
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(hereditary_type) :: run
  type(time_load_type) :: load
  type(base_motion_type) :: base
  type(mesh_type) :: mesh
  type(watch_type), allocatable :: watch
  type(status_type) :: outcome
  real(c_double), allocatable :: some_states(:, :), some_at_times(:, :)
  real(c_double), allocatable :: u(:), v(:)
  integer, allocatable :: dofs(:), rows(:)
  integer :: i, piece
  ! Absent where not allocated.
  real(c_double), allocatable :: least
  logical, allocatable :: with_kinks
  logical :: made

  kept = 0.0_c_double
  last = initial
  at_times = 0.0_c_double
  n_kept = 0
  n_done = 0
  n_reached = 0
  t_reached = 0.0_c_double
  n_iterations = 0
  resolution = 0.0_c_double
  ended = 0
  found = 0.0_c_double
  n_found = 0
  too_long = 0.0_c_double
  reason = begun
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) then
    dofs = pack([(i, i=1, n_dof)], moves /= 0)
    rows = pack([(i, i=1, 2*n_dof)], state_mask(moves /= 0))
    if (size(dofs) < n_dof) call keep_moving(system, moves /= 0)
    load%frequencies = frequencies
    load%amplitudes = amplitudes(dofs, :)
    load%breaks = breaks
    load%pieces = pieces(dofs, :, :)
    if (any(abs(waves) > 0.0_c_double) .or. n_base > 1) then
      if (n_waves > 1) then
        call make_base(base, [real(c_double) ::], frequencies, waves(dofs, :), base_breaks, &
                       base_pieces(:, dofs, :))
      else
        call make_base(base, system%base_direction, frequencies, waves, base_breaks, base_pieces)
      end if
    end if
    call new_mesh(mesh, h, ends, made_by)
    piece = mesh%piece_of(first)
    u = initial(2*dofs - 1)
    v = initial(2*dofs)
    call base%enter(mesh%beginning(piece), mesh%ends(piece))
    call base%add_to(mesh%start_of(first), u, v, share=-1.0_c_double)
    if (shortest > 0.0_c_double) then
      least = shortest
      with_kinks = kinks /= 0
    end if
    call new_hereditary(run, system, load, s, past, held(dofs), u, v, mesh%h(piece), t_end, &
                        tolerance, reason, before, moved(dofs, :), least, with_kinks)
    made = .true.
    if (reason == begun .and. resume /= 0) then
      call run%load_memory(memory, resume == 2)
      if (resume == 2) call run%take_up(system, load, mesh%start_of(first), u, v, made)
      if (.not. made) reason = step_too_large
    end if
    if (reason == begun) then
      if (size(dofs) == n_dof) then
        ! Watched motions have all coordinates computed.
        if (n_watch > 1) then
          allocate (watch)
          call new_watch(watch, watched, sides, run%n_observed())
        end if
        call run_hereditary(run, system, load, base, first, n_steps, save_every, times, states, &
                            at_times, n_done, n_reached, t_reached, ended, mesh, resume == 2, &
                            watch, too_long)
        if (n_watch > 1) call watch%hand_over(sides, found, n_found)
      else
        allocate (some_states(size(rows), n_columns), some_at_times(size(rows), n_times))
        some_at_times = 0.0_c_double
        call run_hereditary(run, system, load, base, first, n_steps, save_every, times, &
                            some_states, some_at_times, n_done, n_reached, t_reached, ended, mesh, &
                            resume == 2, thinnest=too_long)
        states = 0.0_c_double
        states(rows, :) = some_states
        at_times(rows, :) = some_at_times
      end if
      u = run%u
      v = run%v
      call base%add_to(t_reached, u, v)
      last(2*dofs - 1) = u
      last(2*dofs) = v
      n_iterations = run%equations%n_iterations
      resolution = run%resolution()
      n_kept = run%memory_size()
      if (n_kept <= n_memory) kept(:n_kept) = run%save_memory()
    end if
  end if
  too_long = too_long/(unseen_by_node*s)
  call report(outcome, status)

end subroutine mount_simulate

!> Which coordinates move (1) if those with driven /= 0 are driven, as `moves` above.
subroutine moving_coordinates(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                              driven, n_dof, moves, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_system, report
  use viscovib_oscillator, only: oscillator_type
  use viscovib_reduction, only: moved_coordinates
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_dof, driven(n_dof)
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi)
  integer(c_int), intent(out) :: moves(n_dof), status
  class(oscillator_type), allocatable :: system
  type(status_type) :: outcome

  moves = 1
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) moves = merge(1, 0, moved_coordinates(system, driven /= 0))
  call report(outcome, status)
end subroutine moving_coordinates

!> What a motion with memory computes and skips. method: the place in
!! `hereditary_methods`; past: in `past_names`; last_only /= 0: one state is kept.
subroutine hereditary_plan(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                           series, n_rows, n_series, initial, held, t_end, dt, tolerance, method, &
                           past, save_every, last_only, text, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_system, report
  use viscovib_hereditary_job, only: hereditary_job, plan_hereditary
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series
  integer(c_int), intent(in) :: orders(n_series), method, past, save_every, last_only
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  real(c_double), intent(in) :: initial(2*n_rows - 2), held(n_rows - 1), t_end, dt, tolerance
  character(len=2048), intent(out) :: text
  integer(c_int), intent(out) :: status
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(hereditary_job) :: job
  type(status_type) :: outcome

  text = ''
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    job%initial = initial
    job%held = held
    job%t_end = t_end
    job%dt = dt
    job%tolerance = tolerance
    job%method = method
    job%past = past
    job%save_every = save_every
    job%last_only = last_only /= 0
    text = plan_hereditary(job, system, load)
  end if
  call report(outcome, status)
end subroutine hereditary_plan
