!> A motion with memory as one job: a periodic load, a start, an end.
module viscovib_hereditary_job
  use viscovib_memory_channels, only: channels_type, new_channels
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_idle, counting
  use viscovib_histories, only: error_of_sums, past_direct, past_exponentials
  use viscovib_job, only: plan_line
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_memory_pieces, only: memory_equations, oscillator_equations
  use viscovib_motion_choice, only: driven_coordinates, hereditary_methods, keep_direct, nodes, &
    past_auto, per_period
  use viscovib_oscillator, only: oscillator_type
  use viscovib_plan_text, only: report_idle, report_laws, report_zeros
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_piece_runs, only: piece_runs
  use viscovib_status, only: show, status_type, things
  use viscovib_transient_job, only: run_motion, trajectory_type, transient_job
  use viscovib_transient_plan, only: plan_steps
  implicit none
  private

  public :: hereditary_job, run_hereditary_job, run_with_memory, plan_hereditary, plan_forces

  !> Largest number of steps for which 'auto' stores the whole past.
  integer(i8), parameter :: most_direct = 20000_i8
  !> Kernels as exponentials are fitted for this multiple of the run time.
  real(wp), parameter, public :: reach = 100.0_wp
  real(wp), parameter :: rounding = 1.0e-15_wp
  !> Factor of the usual error of equations of memory if that met no tolerance.
  real(wp), parameter :: sharper = 1.0e-4_wp

  !> `method` is the index in `hereditary_methods`.
  type, extends(transient_job) :: hereditary_job
    !> Circular frequency of the load (rad/s), if it has one.
    real(wp) :: nu = 0.0_wp
    !> Index in `past_names`.
    integer :: past = past_auto
  end type hereditary_job

contains

  !> Compute the motion; coordinates that do not move are omitted from the equations.
  subroutine run_hereditary_job(job, system, load, fastest, trajectory, status)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in) :: load
    !> Fastest natural frequency (rad/s).
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(oscillator_equations), target :: equations

    equations%system => system
    equations%moves = moved_coordinates(system, &
                                        driven_coordinates(system, load, job%initial, job%held, &
                                                           allocated(job%watched)))
    call equations%set_past(job%held)
    call equations%set_loads(system, load)
    call equations%set_load(system, load, job%nu)
    if (counting) call count_up(counted_idle, count(.not. equations%moves))
    call run_with_memory(job, system, equations, &
                         max(fastest, maxval([0.0_wp, equations%frequencies])), load%corners(), &
                         trajectory, status)
  end subroutine run_hereditary_job

  !> A motion by equations with memory, with steps and past as in the job. An unstable
  !! motion with memory amplifies the errors of equations and kernels: if no step meets the
  !! tolerance, they are solved more accurately.
  subroutine run_with_memory(job, system, equations, fastest, corners, trajectory, status)
    type(hereditary_job), intent(in), target :: job
    class(oscillator_type), intent(in), target :: system
    class(memory_equations), intent(inout), target :: equations
    !> The frequency that determines the first steps (rad/s).
    real(wp), intent(in) :: fastest
    !> Of the loads (s).
    real(wp), intent(in) :: corners(:)
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(piece_runs) :: runs
    real(wp) :: wanted
    logical :: remembers

    call equations%set_nodes(nodes(job%method))
    equations%t_end = reach*job%t_end
    call equations%look_at(system)
    remembers = any(system%kernel_of > 0)
    runs%equations => equations
    runs%first%past = merge(past_direct, past_exponentials, job%past == keep_direct)
    if (job%past == past_auto) runs%most_direct = most_direct
    runs%first%tolerance = rounding
    ! Without memory the step alone determines the error.
    if (remembers .or. job%dt > 0.0_wp) then
      runs%first%tolerance = max(0.1_wp*job%wanted(), rounding)
    end if
    wanted = max(4.0_wp, job%t_end*fastest*per_period(job%method)/(2.0_wp*pi))
    call run_motion(runs, job, wanted, corners, merge(2, 1, remembers), trajectory, status)
    if (.not. (status%failed() .and. job%dt <= 0.0_wp .and. remembers)) return
    if (status%subject /= 'tolerance') return
    runs%first%tolerance = max(sharper*runs%first%tolerance, rounding)
    call run_motion(runs, job, wanted, corners, merge(2, 1, remembers), trajectory, status)
  end subroutine run_with_memory

  !> Text of the plan: computed and skipped parts, with reasons.
  function plan_hereditary(job, system, load) result(text)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')
    type(polynomial_type) :: reduced
    logical :: moved(system%n_dof())

    text = 'computes: motion to t = '//show(job%t_end)//' by '//hereditary_methods(job%method) &
           //', accelerations at '//things(nodes(job%method), 'node')//' per step'//nl &
           //plan_steps(job)
    moved = moved_coordinates(system, driven_coordinates(system, load, job%initial, job%held, &
                                                         allocated(job%watched)))
    if (all(moved)) then
      text = text//plan_forces(job, system, load)
    else
      call reduce(system, moved, reduced)
      text = text//plan_forces(job, reduced, load)//report_idle(moved)
    end if
    text = text//report_laws(system)//report_zeros(system, load)
  end function plan_hereditary

  !> Lines of the plan about forces and their memory.
  function plan_forces(job, system, load) result(text)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')
    type(channels_type) :: channels
    type(collocation_type) :: table
    real(wp), allocatable :: weights(:), rates(:)
    real(wp) :: least
    integer :: k, first

    text = plan_line(.not. system%is_linear(), 'nonlinear forces, by iteration in each step', &
                     'iteration in each step (nothing is nonlinear)')
    call new_channels(channels, system, 0.0_wp*system%mass(:, 1))
    call new_collocation(table, nodes(job%method))
    if (size(channels%kernel_of) == 0) then
      text = text//'skips: memory (no kernels)'//nl
      return
    end if
    least = 0.25_wp
    if (job%dt > 0.0_wp) least = job%dt
    do k = 1, size(system%kernels)
      first = count(channels%kernel_of == k)
      if (first == 0) cycle
      text = text//'computes: memory of '//things(first, 'force')//' with kernel '//show(k)//', '
      ! The step is not yet known; a step of 1/4 gives the order of magnitude.
      call system%kernels(k)%exponentials(error_of_sums(0.1_wp*job%wanted(), least), &
                                                 least*table%points(1), reach*job%t_end, weights, &
                                                 rates)
      if (job%past == keep_direct .or. size(rates) == 0) then
        text = text//'by the whole past at every step'//nl
      else if (job%dt > 0.0_wp) then
        text = text//'as '//things(size(rates), 'exponential')//nl
      else
        text = text//'as about '//things(size(rates), 'exponential')//nl
      end if
    end do
    if (any(abs(job%initial) > 0.0_wp) .or. size(load%orders) == 0) return
    if (all(load%orders > 0) .and. .not. load%moves_base() &
        .and. all([(abs(aimag(load%force_at(k, job%nu))) <= 0.0_wp, k=1, size(load%orders))])) then
      text = text//'skips: fine steps at a singular start (it starts from rest without load)'//nl
    end if
  end function plan_forces

end module viscovib_hereditary_job
