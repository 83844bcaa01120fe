!> Stability of quasi-periodic solutions of a driven system: growth rates of small perturbations
!! (Lyapunov exponents).
!!
!! The variational equation y'' = da/dq y + da/dq' y' along the solution is integrated by the
!! Dormand-Prince method of order 8 with equal steps, one column in each lane. The columns are
!! orthogonalized after each step (Benettin et al., Meccanica 15 (1980) 9). The logarithms of their
!! lengths are averaged with the weight exp(-1/(s (1-s))), s = t/T: along quasi-periodic motions
!! this mean converges faster than any power of 1/T (Das, Saiki, Sander, Yorke, Nonlinearity 30
!! (2017) 4111). Means over each half of T show the convergence: their errors are larger.
module viscovib_torus_growth
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_explicit_tables, only: explicit_table_type, max_stages, new_explicit_table
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_sorting, only: order_of
  use viscovib_stage_kernels, only: stage_states, stage_sums
  use viscovib_stopping, only: is_set
  use viscovib_torus_balance, only: torus_balance_type
  use viscovib_vector_math, only: largest_angle, sine_cosine_lanes
  implicit none
  private

  public :: growth_rates

  !> Largest phase angle of a perturbation, or of the fastest relevant line, in a step.
  real(wp), parameter :: phase_a_step = 1.0_wp
  integer, parameter :: max_steps = 1000000
  !> Factor of the error estimate from means over the halves of T, and error of the steps, in units
  !! of the fastest frequency (sums of rates against the mean divergence: at most 2e-8).
  real(wp), parameter :: halves_decide = 4.0_wp, of_steps = 2.0e-8_wp
  !> Orders below this fraction of the largest are ignored here; orders below the second fraction do
  !! not limit the step.
  real(wp), parameter :: smallest_part = 1.0e-10_wp, smallest_fast = 1.0e-6_wp
  !> Index of the Dormand-Prince method in the tables.
  integer, parameter :: method = 2

  !> The motion as a sum of lines, in blocks of lanes: sine and cosine parts, shape (n_lanes,
  !! n_blocks, n_dof), and frequencies, shape (n_lanes, n_blocks).
  type :: lines_type
    real(wp), allocatable :: sine(:, :, :), cosine(:, :, :), w(:, :)
    real(wp) :: fastest = 0.0_wp
  end type lines_type

contains

  !> Growth rates along the solution x of `balance`, which has at most four coordinates and was just
  !! evaluated at x. NaN if too many steps are needed or the computation was cancelled.
  subroutine growth_rates(balance, x, duration, rates, off, cancel)
    type(torus_balance_type), intent(in) :: balance
    !> Unknowns, shape (balance%n).
    real(wp), intent(in) :: x(:)
    !> The time T.
    real(wp), intent(in) :: duration
    !> Largest first, shape (2 n_dof).
    real(wp), intent(out) :: rates(:)
    !> Estimated error of each.
    real(wp), intent(out) :: off(:)
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(explicit_table_type) :: table
    type(lines_type) :: lines
    real(wp), dimension(n_lanes, max_dof) :: q, v, stage_q, stage_v, in_q, in_v
    real(wp), dimension(n_lanes, balance%system%n_dof) :: motion, speed, a
    real(wp) :: drive(n_lanes, size(balance%amplitude)), turns(size(balance%amplitude))
    real(wp) :: f(n_lanes, max_dof, max_stages), h(n_lanes)
    real(wp) :: needed, time, total(3), stretch(2*balance%system%n_dof)
    real(wp) :: sums(2*balance%system%n_dof, 3), swings
    integer :: d, i, n, n_steps, order(size(rates)), s, half

    n = balance%system%n_dof
    rates = ieee_value(0.0_wp, ieee_quiet_nan)
    off = rates
    call new_explicit_table(table, method)
    call gather_lines(balance, x, lines)
    needed = duration*max(balance%rate(), lines%fastest)/phase_a_step
    if (.not. needed <= max_steps) return
    if (.not. duration*maxval(abs(lines%w)) <= largest_angle) return
    n_steps = max(100, ceiling(needed))
    h = duration/n_steps
    turns = matmul(balance%omega, balance%drive_orders)
    q = 0.0_wp
    v = 0.0_wp
    f = 0.0_wp
    stage_q = 0.0_wp
    stage_v = 0.0_wp
    ! The start vectors contain all directions, for any symmetry of the motion.
    do d = 1, n
      q(:2*n, d) = [(cos(1.0_wp*i*(2*d - 1)**2), i=1, 2*n)]
      v(:2*n, d) = [(cos(1.0_wp*i*(2*d)**2), i=1, 2*n)]
    end do
    call make_orthogonal(n, q, v, stretch)
    sums = 0.0_wp
    total = 0.0_wp
    swings = 0.0_wp
    do s = 1, n_steps
      if (is_set(cancel)) return
      do i = 1, table%n_stages
        call stage_sums(n, table%n_terms(i), table%from(1, i), table%weights(1, 1, i), f, in_q, &
                        in_v)
        call stage_states(n, table%c(i), h, q, v, in_q, in_v, stage_q, stage_v)
        time = (s - 1 + table%c(i))*h(1)
        call state_at(lines, time, motion, speed)
        drive = spread(balance%factor*balance%amplitude &
                       *cos(modulo(turns*time, 2.0_wp*pi)), 1, n_lanes)
        call balance%system%tangent(motion, speed, drive, stage_q, stage_v, a, f(1, 1, i))
      end do
      i = table%n_stages + 1
      call stage_sums(n, table%n_terms(i), table%from(1, i), table%weights(1, 1, i), f, in_q, in_v)
      call stage_states(n, 1.0_wp, h, q, v, in_q, in_v, stage_q, stage_v)
      q(:, :n) = stage_q(:, :n)
      v(:, :n) = stage_v(:, :n)
      call make_orthogonal(n, q, v, stretch)
      if (.not. all(stretch > 0.0_wp .and. stretch <= huge(1.0_wp))) return
      time = (s - 0.5_wp)/n_steps
      swings = max(swings, maxval(abs(log(stretch)))/h(1))
      half = merge(1, 2, time < 0.5_wp)
      call add_weighted(time, h(1), log(stretch), sums(:, 3), total(3))
      call add_weighted(2.0_wp*time - (half - 1), h(1), log(stretch), sums(:, half), total(half))
    end do
    do half = 1, 3
      sums(:, half) = sums(:, half)/total(half)
    end do
    rates = sums(:, 3)
    off = halves_decide*max(abs(sums(:, 1) - rates), abs(sums(:, 2) - rates)) &
          + of_steps*needed/duration
    ! Within a few periods the means over the halves agree: lengths still vary as at the start.
    off = off + swings*exp(-needed*phase_a_step/(2.0_wp*pi))
    order = order_of(-rates)
    rates = rates(order)
    off = off(order)
  end subroutine growth_rates

  !> Add to a mean over a time span; `part` is the elapsed fraction.
  pure subroutine add_weighted(part, h, grown, sums, total)
    real(wp), intent(in) :: part, h, grown(:)
    real(wp), intent(inout) :: sums(:), total
    real(wp) :: weight

    if (.not. (part > 0.0_wp .and. part < 1.0_wp)) return
    weight = exp(-1.0_wp/(part*(1.0_wp - part)))
    sums = sums + weight*grown
    total = total + weight*h
  end subroutine add_weighted

  subroutine gather_lines(balance, x, lines)
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: x(:)
    type(lines_type), intent(out) :: lines
    real(wp) :: y(balance%torus%n, balance%system%n_dof), largest, part
    real(wp) :: w(size(balance%torus%orders, 2))
    integer :: k, m, lane, block

    y = balance%expanded(x)
    largest = maxval(abs(y))
    w = balance%torus%frequencies(balance%omega)
    m = (size(w) + n_lanes - 1)/n_lanes
    allocate (lines%sine(n_lanes, m, size(y, 2)), lines%cosine(n_lanes, m, size(y, 2)), &
              lines%w(n_lanes, m), source=0.0_wp)
    ! The mean is a cosine of frequency 0.
    lines%cosine(1, 1, :) = y(1, :)
    m = 1
    do k = 2, size(w)
      part = maxval(abs(y(2*k - 2:2*k - 1, :)))
      if (.not. part > smallest_part*largest) cycle
      m = m + 1
      block = (m - 1)/n_lanes + 1
      lane = m - n_lanes*(block - 1)
      lines%sine(lane, block, :) = y(2*k - 2, :)
      lines%cosine(lane, block, :) = y(2*k - 1, :)
      lines%w(lane, block) = w(k)
      if (part > smallest_fast*largest) lines%fastest = max(lines%fastest, abs(w(k)))
    end do
    block = (m - 1)/n_lanes + 1
    lines%sine = lines%sine(:, :block, :)
    lines%cosine = lines%cosine(:, :block, :)
    lines%w = lines%w(:, :block)
  end subroutine gather_lines

  !> Coordinates and velocities at a time, equal in all lanes.
  pure subroutine state_at(lines, time, motion, speed)
    type(lines_type), intent(in) :: lines
    real(wp), intent(in) :: time
    real(wp), intent(out) :: motion(:, :), speed(:, :)
    real(wp), dimension(n_lanes) :: angle, s, c
    real(wp), dimension(n_lanes, size(motion, 2)) :: q, v
    integer :: b, d

    q = 0.0_wp
    v = 0.0_wp
    do b = 1, size(lines%w, 2)
      angle = lines%w(:, b)*time
      call sine_cosine_lanes(angle, s, c)
      do d = 1, size(motion, 2)
        q(:, d) = q(:, d) + lines%sine(:, b, d)*s + lines%cosine(:, b, d)*c
        v(:, d) = v(:, d) + lines%w(:, b)*(lines%sine(:, b, d)*c - lines%cosine(:, b, d)*s)
      end do
    end do
    do d = 1, size(motion, 2)
      motion(:, d) = sum(q(:, d))
      speed(:, d) = sum(v(:, d))
    end do
  end subroutine state_at

  !> Gram-Schmidt orthogonalization of the states (q, v) of the first 2 n lanes; `stretch` are their
  !! lengths before normalization.
  pure subroutine make_orthogonal(n, q, v, stretch)
    integer, intent(in) :: n
    real(wp), intent(inout) :: q(n_lanes, max_dof), v(n_lanes, max_dof)
    real(wp), intent(out) :: stretch(2*n)
    real(wp) :: along
    integer :: i, j

    do i = 1, 2*n
      do j = 1, i - 1
        along = sum(q(i, :n)*q(j, :n)) + sum(v(i, :n)*v(j, :n))
        q(i, :n) = q(i, :n) - along*q(j, :n)
        v(i, :n) = v(i, :n) - along*v(j, :n)
      end do
      stretch(i) = sqrt(sum(q(i, :n)**2) + sum(v(i, :n)**2))
      q(i, :n) = q(i, :n)/max(stretch(i), tiny(along))
      v(i, :n) = v(i, :n)/max(stretch(i), tiny(along))
    end do
  end subroutine make_orthogonal

end module viscovib_torus_growth
