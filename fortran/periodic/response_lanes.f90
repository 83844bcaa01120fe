! Optimize: -O3
!> Data of the frequencies in the vector lanes during the iteration of the nonlinear steady
!! response: the force of the present motion and the next motion.
module viscovib_response_lanes
  use viscovib_counters, only: count_up, counted_loads, counting
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: advance, allocate_block, block_type, fill_lane, lane_norm, load_lane, &
            nonlinear_force, restart_lane, solve_lanes

  !> Data of the frequencies under iteration. Real and imaginary parts are separate (second index of
  !! size 2, or names re, im), so that all loops run along the lanes.
  type :: block_type
    !> The point of the chunk in each lane; 0: idle.
    integer :: point(n_lanes) = 0
    integer :: iteration(n_lanes) = 0, halvings(n_lanes) = 0
    real(wp) :: relaxation(n_lanes) = 1.0_wp
    !> The last three corrections, newest first; the smallest one; the norm of
    !! the linear response.
    real(wp) :: recent(3, n_lanes) = 0.0_wp
    real(wp) :: smallest(n_lanes) = 0.0_wp, start_norm(n_lanes) = 0.0_wp
    !> Frequency (rad/s).
    real(wp) :: nu(n_lanes) = 0.0_wp
    !> Iterate, and the load, shape (n_lanes, 2, n_orders, n_dof).
    real(wp), allocatable :: u(:, :, :, :), load(:, :, :, :)
    !> Compliance, shape (n_lanes, n_dof, n_dof, n_orders).
    real(wp), allocatable :: c_re(:, :, :, :), c_im(:, :, :, :)
    !> Memory factors 1 - Rhat, shape (n_lanes, n_memory, n_orders).
    real(wp), allocatable :: f_re(:, :, :), f_im(:, :, :)
    !> Workspace: next iterate and nonlinear force (as u), hereditary variables (n_lanes, 2,
    !! n_orders, n_memory), and samples (n_lanes*n_samples, n_dof or n_memory).
    real(wp), allocatable :: next(:, :, :, :), force(:, :, :, :), w(:, :, :, :)
    real(wp), allocatable :: u_samples(:, :), w_samples(:, :), f_samples(:, :)
  end type block_type

contains

  subroutine allocate_block(work, system, set)
    type(block_type), intent(out) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer :: k, d, m, s

    k = size(set%orders)
    d = system%n_dof()
    m = system%n_memory()
    s = n_lanes*set%n_samples
    allocate (work%u(n_lanes, 2, k, d), work%load(n_lanes, 2, k, d), &
              work%next(n_lanes, 2, k, d), work%force(n_lanes, 2, k, d), &
              work%w(n_lanes, 2, k, m), &
              work%c_re(n_lanes, d, d, k), work%c_im(n_lanes, d, d, k), &
              work%f_re(n_lanes, m, k), work%f_im(n_lanes, m, k), &
              work%u_samples(s, d + system%n_rates()), work%w_samples(s, m), &
              work%f_samples(s, d), source=0.0_wp)
  end subroutine allocate_block

  !> Largest value of sqrt(M_dd) (|Re X| + |Im X|) in each lane.
  pure function lane_norm(system, x) result(norm)
    class(oscillator_type), intent(in) :: system
    !> Shape (n_lanes, 2, n_orders, n_dof).
    real(wp), intent(in) :: x(:, :, :, :)
    real(wp) :: norm(n_lanes)
    integer :: d, k
    norm = 0.0_wp
    do d = 1, size(x, 4)
      do k = 1, size(x, 3)
        norm = max(norm, sqrt(system%mass(d, d))*(abs(x(:, 1, k, d)) + abs(x(:, 2, k, d))))
      end do
    end do
  end function lane_norm

  !> Start a point from its linear response.
  subroutine load_lane(work, lane, point, system, load, set, relaxation, nu, fraction, &
                       compliance)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane, point
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: relaxation, nu
    complex(wp), intent(in) :: fraction(:, :), compliance(:, :, :)

    if (counting) call count_up(counted_loads, size(load%orders))
    work%halvings(lane) = 0
    work%relaxation(lane) = merge(relaxation, 1.0_wp, relaxation > 0.0_wp)
    call fill_lane(work, lane, point, system, load, set, nu, fraction, compliance)
    call restart_lane(work, lane)
  end subroutine load_lane

  !> The data of a point in a lane, without a motion.
  subroutine fill_lane(work, lane, point, system, load, set, nu, fraction, compliance)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane, point
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: nu
    complex(wp), intent(in) :: fraction(:, :), compliance(:, :, :)
    complex(wp) :: p(system%n_dof())
    integer :: b, j, k

    work%point(lane) = point
    work%nu(lane) = nu
    do k = 1, size(set%orders)
      work%f_re(lane, :, k) = real(fraction(:, k))
      work%f_im(lane, :, k) = aimag(fraction(:, k))
      do b = 1, size(compliance, 2)
        work%c_re(lane, :, b, k) = real(compliance(:, b, k))
        work%c_im(lane, :, b, k) = aimag(compliance(:, b, k))
        work%load(lane, :, k, b) = 0.0_wp
      end do
    end do
    do j = 1, size(load%orders)
      do k = 1, size(set%orders)
        if (set%orders(k) /= load%orders(j)) cycle
        p = load%coefficient(system, set%orders(k), nu)
        work%load(lane, 1, k, :) = real(p)
        work%load(lane, 2, k, :) = aimag(p)
      end do
    end do
  end subroutine fill_lane

  !> (Re-)start a lane from its linear response.
  subroutine restart_lane(work, lane)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane
    real(wp) :: re, im
    integer :: b, k

    work%u(lane, :, :, :) = 0.0_wp
    do b = 1, size(work%u, 4)
      do k = 1, size(work%u, 3)
        re = work%load(lane, 1, k, b)
        im = work%load(lane, 2, k, b)
        if (.not. (abs(re) > 0.0_wp .or. abs(im) > 0.0_wp)) cycle
        work%u(lane, 1, k, :) = work%u(lane, 1, k, :) + work%c_re(lane, :, b, k)*re &
                                - work%c_im(lane, :, b, k)*im
        work%u(lane, 2, k, :) = work%u(lane, 2, k, :) + work%c_re(lane, :, b, k)*im &
                                + work%c_im(lane, :, b, k)*re
      end do
    end do
    work%iteration(lane) = 0
    work%recent(:, lane) = 0.0_wp
    work%smallest(lane) = huge(1.0_wp)
  end subroutine restart_lane

  !> Harmonics of the nonlinear force at the present iterates.
  subroutine nonlinear_force(work, system, set)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer :: j, d

    do d = 1, system%n_dof()
      call set%to_samples(work%u(:, :, :, d), work%u_samples(:, d))
    end do
    if (system%n_rates() > 0) call sample_rates(work, system, set)
    call system%deflection_remainder(work%u_samples, work%w_samples)
    do j = 1, system%n_memory()
      if (.not. system%bent(j)) cycle
      call set%to_harmonics(work%w_samples(:, j), work%w(:, :, :, j))
      if (system%kernel_of(j) == 0) cycle
      call retain(work%f_re(:, j, :), work%f_im(:, j, :), work%w(:, :, :, j))
    end do
    work%force = 0.0_wp
    if (.not. system%separable) call inseparable_force(work, system, set)
    do d = 1, system%n_dof()
      do j = 1, system%n_memory()
        if (.not. system%bent(j) .or. system%spread(d, j) == 0.0_wp) cycle
        work%force(:, :, :, d) = work%force(:, :, :, d) + system%spread(d, j)*work%w(:, :, :, j)
      end do
    end do
  end subroutine nonlinear_force

  !> Samples of the rates that laws contain.
  subroutine sample_rates(work, system, set)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    real(wp) :: rate(n_lanes, 2, size(set%orders))
    integer :: d, k

    do d = 1, system%n_rates()
      do k = 1, size(set%orders)
        rate(:, 1, k) = -set%orders(k)*work%nu*work%u(:, 2, k, system%rates(d))
        rate(:, 2, k) = set%orders(k)*work%nu*work%u(:, 1, k, system%rates(d))
      end do
      call set%to_samples(rate, work%u_samples(:, system%n_dof() + d))
    end do
  end subroutine sample_rates

  !> The part F(u, v) - B v, which requires v in time, including its linear part.
  subroutine inseparable_force(work, system, set)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    real(wp) :: v(n_lanes, 2, size(set%orders))
    integer :: j, d

    do j = 1, system%n_memory()
      v = 0.0_wp
      do d = 1, system%n_dof()
        v = v + system%gather(j, d)*work%u(:, :, :, d)
      end do
      if (system%kernel_of(j) > 0) call retain(work%f_re(:, j, :), work%f_im(:, j, :), v)
      if (system%bent(j)) v = v + work%w(:, :, :, j)
      call set%to_samples(v, work%w_samples(:, j))
    end do
    call system%force_remainder(work%u_samples, work%w_samples, work%f_samples)
    do d = 1, system%n_dof()
      call set%to_harmonics(work%f_samples(:, d), work%force(:, :, :, d))
    end do
  end subroutine inseparable_force

  !> Multiply harmonics by their memory factors.
  pure subroutine retain(f_re, f_im, w)
    real(wp), intent(in) :: f_re(:, :), f_im(:, :)
    real(wp), intent(inout) :: w(:, :, :)
    real(wp) :: re
    integer :: k, l
    do k = 1, size(w, 3)
      do l = 1, n_lanes
        re = f_re(l, k)*w(l, 1, k) - f_im(l, k)*w(l, 2, k)
        w(l, 2, k) = f_re(l, k)*w(l, 2, k) + f_im(l, k)*w(l, 1, k)
        w(l, 1, k) = re
      end do
    end do
  end subroutine retain

  !> next_k = C_k (load_k - force_k).
  pure subroutine solve_lanes(work)
    type(block_type), intent(inout) :: work
    real(wp) :: re(n_lanes), im(n_lanes), p_re, p_im
    integer :: a, b, k, l

    do a = 1, size(work%u, 4)
      do k = 1, size(work%u, 3)
        re = 0.0_wp
        im = 0.0_wp
        do b = 1, size(work%u, 4)
          do l = 1, n_lanes
            p_re = work%load(l, 1, k, b) - work%force(l, 1, k, b)
            p_im = work%load(l, 2, k, b) - work%force(l, 2, k, b)
            re(l) = re(l) + work%c_re(l, a, b, k)*p_re - work%c_im(l, a, b, k)*p_im
            im(l) = im(l) + work%c_re(l, a, b, k)*p_im + work%c_im(l, a, b, k)*p_re
          end do
        end do
        work%next(:, 1, k, a) = re
        work%next(:, 2, k, a) = im
      end do
    end do
  end subroutine solve_lanes

  !> Apply the relaxation fraction of the correction.
  pure subroutine advance(work, lane)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane
    real(wp) :: fraction

    fraction = work%relaxation(lane)
    if (fraction < 1.0_wp) then
      work%u(lane, :, :, :) = work%u(lane, :, :, :) &
                              + fraction*(work%next(lane, :, :, :) - work%u(lane, :, :, :))
    else
      work%u(lane, :, :, :) = work%next(lane, :, :, :)
    end if
  end subroutine advance

end module viscovib_response_lanes
