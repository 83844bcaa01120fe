!> A motion in time of a polynomial system without memory or with exponential memory, as one job.
module viscovib_polynomial_job
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_idle, counting
  use viscovib_fitted_memory, only: needs_fit, fit_text
  use viscovib_hidden_memory, only: count_hidden
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_choice, only: driven_coordinates, switches_in_time
  use viscovib_plan_text, only: report_idle, report_laws, report_zeros
  use viscovib_piece_runs, only: piece_runs
  use viscovib_plain_pieces, only: polynomial_equations
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates
  use viscovib_status, only: status_type, things
  use viscovib_transient_job, only: first_steps, run_motion, trajectory_type, transient_job
  use viscovib_transient_plan, only: plan_transient
  implicit none
  private

  public :: run_polynomial_job, plan_polynomial

  !> Largest time of continued runs, relative to the run time: sums for kernels are valid up to it.
  real(wp), parameter :: furthest = 100.0_wp

contains

  !> Compute the motion; coordinates that do not move are omitted from the equations.
  subroutine run_polynomial_job(job, system, load, nu, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in), target :: system
    type(load_type), intent(in) :: load
    !> Circular frequency of the load; fastest frequency of system and load (rad/s).
    real(wp), intent(in) :: nu, fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(polynomial_equations), target :: equations
    type(piece_runs) :: runs

    equations%system => system
    equations%method = job%method
    equations%load = load
    equations%nu = nu
    equations%reach = furthest*job%t_end
    equations%moves = moves(job, system, load)
    call equations%set_past(spread(0.0_wp, 1, system%n_dof()))
    if (allocated(job%held)) call equations%set_past(job%held)
    call equations%set_loads(system, load)
    call equations%look_at(system)
    runs%equations => equations
    runs%first%tolerance = job%solved()
    if (counting) call count_up(counted_idle, count(.not. equations%moves))
    call run_motion(runs, job, job%t_end*fastest/(0.5_wp*pi), load%corners(), 1, trajectory, status)
  end subroutine run_polynomial_job

  !> Coordinates that move. If laws switch all are computed: their states are stored in one order,
  !! for any later loads.
  function moves(job, system, load)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    logical :: moves(size(job%initial)/2)
    real(wp) :: held(size(job%initial)/2)
    held = 0.0_wp
    if (allocated(job%held)) held = job%held
    moves = moved_coordinates(system, driven_coordinates(system, load, job%initial, held, &
                                        allocated(job%watched) .or. switches_in_time(system)))
  end function moves

  !> Text of the plan: computed and skipped parts, with reasons.
  function plan_polynomial(job, system, load, reach) result(text)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Latest time of any run that continues this one, for which kernels are fitted.
    real(wp), intent(in), optional :: reach
    character(len=:), allocatable :: text
    real(wp) :: step, last

    step = 0.0_wp
    if (job%dt > 0.0_wp) step = job%t_end/first_steps(job, 0.0_wp)
    last = furthest*job%t_end
    if (present(reach)) last = reach
    text = 'skips: memory (no kernels)'
    if (count_hidden(system) > 0) text = 'computes: memory by '//things(count_hidden(system), &
                                                                        'exponential')
    if (needs_fit(system)) text = fit_text(system, step, last)
    text = plan_transient(job)//text//new_line('a') &
           //report_idle(moves(job, system, load)) &
           //report_laws(system)//report_zeros(system, load)
  end function plan_polynomial

end module viscovib_polynomial_job
