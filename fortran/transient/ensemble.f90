! Optimize: -O1
!> Many trajectories of one kind of system, eight at a time in the lanes, or four times as many by
!! Taylor's method.
module viscovib_ensemble
  use, intrinsic :: ieee_arithmetic, only: ieee_all, ieee_get_halting_mode, ieee_set_flag, &
    ieee_set_halting_mode
  use viscovib_driven_system, only: differentiable_system_type, driven_system_type
  use viscovib_explicit_tables, only: is_series, lane_methods, series_order
  use viscovib_flight, only: after_step, before_step, ensemble_block, ensemble_job, flight_type, &
    gather, land, take_off
  use viscovib_kinds, only: i8, wp
  use viscovib_lane_motion, only: lane_motion_type
  use viscovib_lanes, only: n_lanes
  use viscovib_motion_series, only: motion_series, new_motion_series
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_stopping, only: is_set
  use viscovib_subnormals, only: flushing_type
  use viscovib_taylor, only: new_taylor, taylor_type
  use viscovib_wide_series, only: n_blocks, n_wide
  implicit none
  private

  public :: blocks_of, check_method, ensemble_job, ensemble_block, run_block, run_together

  type, extends(driven_system_type) :: tangent_system_type
    class(differentiable_system_type), allocatable :: base
  contains
    procedure :: acceleration
    procedure :: margin
  end type tangent_system_type

  !> Steps between two checks for an interruption.
  integer, parameter :: patience = 512

contains

  !> Run a block from time 0; another thread may set `cancel` to interrupt it.
  subroutine run_block(job, system, block, cancel)
    type(ensemble_job), intent(in) :: job
    class(differentiable_system_type), intent(in) :: system
    type(ensemble_block), intent(inout) :: block
    integer, intent(inout) :: cancel
    type(tangent_system_type) :: disturbed

    if (job%n_exponents > 0) then
      call new_tangent_system(disturbed, system)
      call run(job, disturbed, system, block, cancel)
    else
      call run(job, system, system, block, cancel)
    end if
  end subroutine run_block

  subroutine run(job, system, motion, block, cancel)
    type(ensemble_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    !> The same without perturbations, whose coordinates follow those of the motion itself.
    class(differentiable_system_type), intent(in) :: motion
    type(ensemble_block), intent(inout) :: block
    integer, intent(inout) :: cancel
    type(flight_type) :: f
    type(flushing_type) :: flushing
    integer(i8) :: i
    integer :: l
    logical :: good(n_lanes), halting(size(ieee_all))

    call flushing%begin()
    ! Within a step a motion may leave the range of numbers; the results show it.
    call ieee_get_halting_mode(ieee_all, halting)
    call ieee_set_halting_mode(ieee_all, .false.)
    call take_off(f, job, system, motion, block)
    do i = 1, job%n_steps
      if (mod(i, int(patience, i8)) == 0) then
        if (is_set(cancel)) exit
        if (.not. any(f%alive)) exit
      end if
      call before_step(f, i)
      call f%method%step(system)
      call f%method%get_state(f%q, f%v)
      good = f%method%made
      if (allocated(f%others)) then
        do l = 1, size(f%others)
          call f%others(l)%step(system)
          good = good .and. f%others(l)%made
        end do
      end if
      call after_step(f, job, system, motion, block, i, good)
    end do
    call land(f, job, block)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_all, halting)
  end subroutine run

  !> Run blocks of one kind of system together, by Taylor's method.
  subroutine run_together(job, motions, blocks, cancel)
    type(ensemble_job), intent(in) :: job
    !> One system per block; at most `blocks_of` blocks. With fewer, some lanes are idle.
    type(lane_motion_type), intent(in) :: motions(:)
    type(ensemble_block), intent(inout) :: blocks(:)
    integer, intent(inout) :: cancel
    type(flight_type) :: f(size(blocks))
    type(taylor_type) :: taylor
    type(flushing_type) :: flushing
    real(wp), dimension(n_wide, motions(1)%n_dof) :: q, v
    real(wp) :: frequencies(n_wide), h(n_wide)
    integer(i8) :: i
    integer :: b, first, l, last
    logical :: good(n_lanes), alive(n_lanes), halting(size(ieee_all))

    call flushing%begin()
    call ieee_get_halting_mode(ieee_all, halting)
    call ieee_set_halting_mode(ieee_all, .false.)
    q = 0.0_wp
    v = 0.0_wp
    frequencies = 0.0_wp
    h = 0.0_wp
    do b = 1, size(blocks)
      call take_off(f(b), job, motions(b), motions(b), blocks(b))
      first = n_lanes*(b - 1) + 1
      last = n_lanes*b
      q(first:last, :) = f(b)%q
      v(first:last, :) = f(b)%v
      frequencies(first:last) = blocks(b)%frequencies(:, 1)
      h(first:last) = blocks(b)%h
    end do
    call new_taylor(taylor, series_order(job%method), motions, frequencies, q, v, h)
    if (job%moments) then
      call taylor%expand_first()
      do b = 1, size(blocks)
        call taylor%get_accelerations(b, .false., f(b)%a)
        call gather(f(b), motions(b), job, 0_i8)
      end do
    end if
    do i = 1, job%n_steps
      if (mod(i, int(patience, i8)) == 0) then
        if (is_set(cancel)) exit
        if (.not. any([(any(f(b)%alive), b=1, size(f))])) exit
      end if
      call taylor%step()
      do b = 1, size(blocks)
        alive = f(b)%alive
        call before_step(f(b), i)
        call taylor%get_block(b, f(b)%q, f(b)%v, good)
        if (job%moments) call taylor%get_accelerations(b, .true., f(b)%a)
        call after_step(f(b), job, motions(b), motions(b), blocks(b), i, good)
        do l = 1, n_lanes
          if (alive(l) .and. .not. f(b)%alive(l)) call taylor%stop_lane(b, l)
        end do
      end do
    end do
    do b = 1, size(blocks)
      call land(f(b), job, blocks(b))
    end do
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_all, halting)
  end subroutine run_together

  !> Number of blocks that run together.
  pure integer function blocks_of(job)
    type(ensemble_job), intent(in) :: job
    blocks_of = merge(n_blocks, 1, is_series(job%method))
  end function blocks_of

  !> Check that the method supports the job.
  subroutine check_method(job, system, status)
    type(ensemble_job), intent(in) :: job
    class(differentiable_system_type), intent(in) :: system
    type(status_type), intent(out) :: status
    type(motion_series) :: series
    logical :: known

    call set_ok(status)
    if (.not. is_series(job%method)) return
    known = .false.
    select type (system)
    type is (lane_motion_type)
      call new_motion_series(series, [system], known)
    end select
    if (.not. known) then
      call fail(status, status_input_error, 'method', "method = '"//trim(lane_methods(job%method)) &
                //"': is for systems whose laws have power series in time: sums, products, " &
                //'quotients, powers of half and whole numbers, functions of one variable; take ' &
                //"another for this one, as 'verner9'")
    else if (job%n_exponents > 0) then
      call fail(status, status_input_error, 'method', "method = '"//trim(lane_methods(job%method)) &
                //"': gives no Lyapunov exponents; take another, as 'verner9'")
    end if
  end subroutine check_method

  ! A system together with a small perturbation of its solution: the variational equation, in
  ! coordinates (q, dq).

  subroutine new_tangent_system(system, base)
    type(tangent_system_type), intent(out) :: system
    class(differentiable_system_type), intent(in) :: base
    allocate (system%base, source=base)
    system%n_dof = 2*base%n_dof
    system%drives = base%drives
    if (allocated(base%quarters)) system%quarters = base%quarters
    system%limited = base%limited
    system%range = base%range
  end subroutine new_tangent_system

  pure subroutine acceleration(self, q, v, drive, a)
    class(tangent_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    integer :: n
    n = self%base%n_dof
    call self%base%tangent(q, v, drive, q(1, n + 1), v(1, n + 1), a, a(1, n + 1))
  end subroutine acceleration

  pure function margin(self, q)
    class(tangent_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = self%base%margin(q)
  end function margin

end module viscovib_ensemble
