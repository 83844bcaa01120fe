! Optimize: -O2 -fvect-cost-model=dynamic
!> Motions of modulation equations with terms that rotate in every frame: beating amplitudes,
!!
!!   a_j(t) = sum_m A_jm exp(i m.B t),
!!
!! where B are the beat frequencies (`viscovib_beat_lattice`).
!!
!! The equations are integrated until the initial transient has decayed. A least-squares fit of
!! Fourier terms to the motion after that is the first approximation of Newton's method for
!!
!!   i m.B A_jm = F_m[rates_j(a(theta), theta)],
!!
!! where F_m is the Fourier coefficient over the angles theta of the beats. Orders are added until
!! their effect is negligible. A mode with parametric excitation by one load and direct excitation
!! by another has beats of half a frequency of the equations; these are found by trial. The solution
!! must agree with the integrated motion. Otherwise that motion has other frequencies or is chaotic.
!!
!! Stability: da' = P da + Q conj(da) is integrated along the motion and orthogonalized after each
!! step. The logarithms of the growth of the columns are averaged with weights that vanish smoothly
!! at both ends (Das, Saiki, Sander, Yorke, Nonlinearity 30 (2017) 4111).
module viscovib_beating_flow
  use viscovib_beat_lattice, only: beat_lattice_type, find_beats, max_beats, transform
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_dense, only: solve, solve_complex
  use viscovib_kinds, only: wp
  use viscovib_modulation, only: modulate, modulation_complete
  use viscovib_slow_flow, only: real_matrix, slow_flow_type
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: beating_flow_type, find_beating_flow, amplitudes_at

  !> Results: a beating motion; no convergence to one; amplitudes without bound; convergence
  !! to a motion found before.
  integer, parameter, public :: beats_found = 1, beats_unsettled = 2, beats_beyond = 3, &
                                beats_known = 4
  !> Bounds of the orders tried in turn, by the number of beats; bound of the fit.
  integer, parameter :: bounds(3, 0:max_beats) = reshape([0, 0, 0, 8, 16, 32, 4, 6, 9, 3, 4, 5], &
                                                         [3, max_beats + 1])
  integer, parameter :: first_bound(0:max_beats) = [0, 8, 4, 2]
  !> Orders at the bound are negligible below this fraction of the largest.
  real(wp), parameter :: small_tail = 1.0e-5_wp
  !> Above it the stability is not decided.
  real(wp), parameter :: large_tail = 1.0e-2_wp
  integer, parameter :: n_samples = 480, max_newton = 12, max_steps = 400000
  !> The initial transient has decayed by exp(-this) in the first attempt.
  real(wp), parameter :: settling = 14.0_wp
  !> Relative difference up to which the solution and the integrated motion count as equal.
  real(wp), parameter :: same_motion = 0.02_wp
  !> Relative difference allowed for the fit.
  real(wp), parameter :: near_motion = 0.1_wp
  real(wp), parameter :: two_pi = 6.283185307179586_wp

  type :: beating_flow_type
    integer :: outcome = beats_unsettled
    type(beat_lattice_type) :: lattice
    !> A_jm, shape (n_modes, n_orders).
    complex(wp), allocatable :: a(:, :)
    !> Size of the outermost orders relative to the largest.
    real(wp) :: tail = 0.0_wp
    !> Growth rates of perturbations, descending, shape (2 n_modes), and the error of the largest.
    real(wp), allocatable :: growth(:)
    real(wp) :: growth_error = 0.0_wp
    !> The highest rate of change in the equations, and its part that depends on amplitudes.
    real(wp) :: fastest = 0.0_wp, bent = 0.0_wp
  end type beating_flow_type

contains

  subroutine find_beating_flow(flow, start, others, beats, cancel)
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(in) :: start(:)
    !> Motions found before.
    type(beating_flow_type), intent(in) :: others(:)
    type(beating_flow_type), intent(out) :: beats
    integer, intent(inout) :: cancel
    type(beat_lattice_type) :: given
    complex(wp) :: a(size(start), n_samples)
    real(wp), allocatable :: turn(:)
    real(wp) :: times(n_samples), slowest
    integer :: round, k, n_reached, n_steps, outcome
    logical :: known, found

    allocate (beats%a(size(start), 0), beats%growth(2*size(start)))
    beats%growth = 0.0_wp
    slowest = minval(-real(flow%s))
    turn = [(flow%terms(k)%turn, k=1, size(flow%terms))]
    call find_beats(turn, maxval(flow%frame), beats%lattice, known)
    if (.not. known .or. .not. slowest > 0.0_wp) return
    given = beats%lattice
    do round = 1, 3
      beats%lattice = given
      times = sample_times(beats%lattice, 3.0_wp**(round - 1)*settling/slowest)
      call modulate(flow, start, times, 1.0e-8_wp, max_steps, a, n_reached, n_steps, outcome, &
                    cancel)
      if (outcome /= modulation_complete) then
        beats%outcome = beats_beyond
        return
      end if
      do k = 1, size(others)
        if (misfit_of(others(k), times, a) > same_motion*maxval(abs(a))) cycle
        beats%outcome = beats_known
        return
      end do
      call fit_beats(flow, times, a, beats, found)
      if (is_set(cancel)) return
      if (found) exit
    end do
    if (.not. found) return
    beats%outcome = beats_found
    call find_growth(flow, slowest, beats)
  end subroutine find_beating_flow

  !> Unevenly spaced times from t, over some beats, so that no beats are aliased.
  pure function sample_times(lattice, t) result(times)
    type(beat_lattice_type), intent(in) :: lattice
    real(wp), intent(in) :: t
    real(wp), parameter :: golden = 0.6180339887498949_wp
    real(wp) :: times(n_samples), span
    integer :: i
    span = t
    if (lattice%d > 0) span = 8.0_wp*two_pi/minval(lattice%beat(:lattice%d))
    do i = 1, n_samples
      times(i) = t + span*(i + modulo(i*golden, 1.0_wp))/n_samples
    end do
  end function sample_times

  !> Amplitudes of the beats at time t.
  pure function amplitudes_at(beats, t) result(a)
    type(beating_flow_type), intent(in) :: beats
    real(wp), intent(in) :: t
    complex(wp) :: a(size(beats%a, 1))
    complex(wp) :: power(-beats%lattice%bound:beats%lattice%bound, max_beats)
    integer :: i, j
    power(0, :) = (1.0_wp, 0.0_wp)
    do j = 1, beats%lattice%d
      associate (wave => exp(cmplx(0.0_wp, beats%lattice%beat(j)*t, wp)))
        do i = 1, beats%lattice%bound
          power(i, j) = power(i - 1, j)*wave
          power(-i, j) = conjg(power(i, j))
        end do
      end associate
    end do
    a = (0.0_wp, 0.0_wp)
    do i = 1, size(beats%a, 2)
      associate (m => beats%lattice%orders(:, i))
        a = a + beats%a(:, i)*(power(m(1), 1)*power(m(2), 2)*power(m(3), 3))
      end associate
    end do
  end function amplitudes_at

  !> The beating motion through given samples; `found`: it agrees with them.
  subroutine fit_beats(flow, times, a, beats, found)
    type(slow_flow_type), intent(in) :: flow
    real(wp), intent(in) :: times(:)
    complex(wp), intent(in) :: a(:, :)
    type(beating_flow_type), intent(inout) :: beats
    logical, intent(out) :: found
    integer, allocatable :: moving(:)
    complex(wp), allocatable :: before(:, :)
    integer, allocatable :: orders(:, :)
    real(wp) :: largest
    integer :: i, j, k, bound

    largest = maxval(abs(a))
    moving = pack([(i, i=1, size(a, 1))], maxval(abs(a), 2) > 1.0e-6_wp*largest)
    call first_fit(times, a, beats, found)
    if (.not. found) return
    do i = 1, size(a, 1)
      if (.not. any(moving == i)) beats%a(i, :) = (0.0_wp, 0.0_wp)
    end do
    associate (lattice => beats%lattice)
      do k = 1, size(bounds, 1)
        bound = max(bounds(k, lattice%d), min(lattice%lowest_bound() + 1, &
                                             bounds(size(bounds, 1), lattice%d)))
        if (k > 1 .and. bound == lattice%bound) cycle
        call move_alloc(beats%a, before)
        orders = lattice%orders
        call lattice%set_bound(bound)
        allocate (beats%a(size(a, 1), size(lattice%orders, 2)), source=(0.0_wp, 0.0_wp))
        do i = 1, size(orders, 2)
          do j = 1, size(lattice%orders, 2)
            if (all(orders(:, i) == lattice%orders(:, j))) beats%a(:, j) = before(:, i)
          end do
        end do
        call newton(flow, moving, beats, found)
        if (.not. found) return
        beats%tail = tail_of(beats)
        if (lattice%d == 0 .or. beats%tail <= small_tail) exit
      end do
    end associate
    found = beats%tail <= large_tail .and. misfit_of(beats, times, a) <= same_motion*largest
  end subroutine fit_beats

  pure real(wp) function tail_of(beats)
    type(beating_flow_type), intent(in) :: beats
    tail_of = maxval(abs(beats%a), mask=spread(sum(abs(beats%lattice%orders), 1) &
                                               >= beats%lattice%bound - 1, 1, size(beats%a, 1)))
    tail_of = tail_of/max(maxval(abs(beats%a)), tiny(1.0_wp))
    if (beats%lattice%d == 0) tail_of = 0.0_wp
  end function tail_of

  !> Fit Fourier terms with the frequencies of the beats, or with half a sum of them added.
  subroutine first_fit(times, a, beats, found)
    real(wp), intent(in) :: times(:)
    complex(wp), intent(in) :: a(:, :)
    type(beating_flow_type), intent(inout) :: beats
    logical, intent(out) :: found
    type(beat_lattice_type) :: given
    complex(wp), allocatable :: waves(:, :)
    real(wp) :: misfit, least
    integer :: mask, best

    given = beats%lattice
    least = near_motion*maxval(abs(a))
    found = .false.
    do mask = 0, 2**given%d - 1
      beats%lattice = given
      call beats%lattice%halve(mask)
      call beats%lattice%set_bound(first_bound(given%d))
      call fit_samples(beats%lattice, times, a, beats%a)
      misfit = misfit_of(beats, times, a)
      if (misfit > least) cycle
      found = .true.
      ! Without half frequencies if this fit is sufficient.
      if (mask == 0) return
      least = misfit
      waves = beats%a
      best = mask
    end do
    beats%lattice = given
    if (.not. found) return
    call beats%lattice%halve(best)
    call beats%lattice%set_bound(first_bound(given%d))
    call move_alloc(waves, beats%a)
  end subroutine first_fit

  !> Largest difference between the Fourier sum and the samples.
  pure real(wp) function misfit_of(beats, times, a)
    type(beating_flow_type), intent(in) :: beats
    real(wp), intent(in) :: times(:)
    complex(wp), intent(in) :: a(:, :)
    integer :: i
    misfit_of = 0.0_wp
    do i = 1, size(times), 8
      misfit_of = max(misfit_of, maxval(abs(amplitudes_at(beats, times(i)) - a(:, i))))
    end do
  end function misfit_of

  !> Fourier coefficients on the lattice by least squares.
  subroutine fit_samples(lattice, times, a, waves)
    type(beat_lattice_type), intent(in) :: lattice
    real(wp), intent(in) :: times(:)
    complex(wp), intent(in) :: a(:, :)
    complex(wp), allocatable, intent(out) :: waves(:, :)
    complex(wp) :: basis(size(times), size(lattice%orders, 2)), x(size(lattice%orders, 2))
    complex(wp) :: matrix(size(lattice%orders, 2), size(lattice%orders, 2))
    integer :: i, j, n
    logical :: singular

    n = size(lattice%orders, 2)
    do i = 1, n
      basis(:, i) = exp(cmplx(0.0_wp, sum(lattice%orders(:, i)*lattice%beat)*times, wp))
    end do
    matrix = matmul(conjg(transpose(basis)), basis)
    do i = 1, n
      ! Terms that the samples cannot distinguish share the amplitude.
      matrix(i, i) = matrix(i, i)*(1.0_wp + 1.0e-9_wp)
    end do
    allocate (waves(size(a, 1), n))
    do j = 1, size(a, 1)
      x = matmul(conjg(transpose(basis)), a(j, :))
      call solve_complex(matrix, x, .true., singular)
      waves(j, :) = merge((0.0_wp, 0.0_wp), x, singular)
    end do
  end subroutine fit_samples

  !> Newton's method for rates - i m.B A = 0, for the active modes.
  subroutine newton(flow, moving, beats, found)
    type(slow_flow_type), intent(in) :: flow
    integer, intent(in) :: moving(:)
    type(beating_flow_type), intent(inout) :: beats
    logical, intent(out) :: found
    complex(wp), allocatable :: rates(:, :), p(:, :, :), q(:, :, :)
    real(wp), allocatable :: matrix(:, :), x(:)
    integer, allocatable :: pivots(:)
    complex(wp) :: change
    real(wp) :: size_of, moved
    integer :: n, m, i, j, round
    logical :: singular

    m = size(moving)
    n = size(beats%lattice%orders, 2)
    found = .true.
    if (m == 0) return
    allocate (matrix(2*n*m, 2*n*m), x(2*n*m), pivots(2*n*m))
    do round = 1, max_newton
      call evaluate(flow, moving, beats, rates, p, q)
      call fill(moving, beats, rates, p, q, matrix, x)
      call factorize_blocks(2*n*m, matrix, pivots, singular)
      found = .not. singular
      if (.not. found) return
      call solve(2*n*m, matrix, pivots, x)
      size_of = maxval(abs(beats%a))
      moved = 0.0_wp
      do i = 1, n
        do j = 1, m
          change = cmplx(x((i - 1)*m + j), x((n + i - 1)*m + j), wp)
          beats%a(moving(j), i) = beats%a(moving(j), i) + change
          moved = max(moved, abs(change))
        end do
      end do
      found = moved <= 10.0_wp*size_of
      if (.not. found .or. moved <= 1.0e-9_wp*size_of) return
    end do
    found = moved <= 1.0e-7_wp*size_of
  end subroutine newton

  !> Fourier coefficients over the grid of the rates and their derivatives, for the active modes.
  subroutine evaluate(flow, moving, beats, rates, p, q)
    type(slow_flow_type), intent(in) :: flow
    integer, intent(in) :: moving(:)
    type(beating_flow_type), intent(in) :: beats
    complex(wp), allocatable, intent(out) :: rates(:, :), p(:, :, :), q(:, :, :)
    type(slow_flow_type) :: here
    complex(wp), allocatable :: a(:, :)
    complex(wp), dimension(flow%n_modes, flow%n_modes) :: by_a, by_conjugate
    complex(wp), dimension(flow%n_modes) :: da, now
    integer :: i, j, k, points

    associate (lattice => beats%lattice)
      points = lattice%n_points()
      allocate (a(points, flow%n_modes), source=(0.0_wp, 0.0_wp))
      do j = 1, flow%n_modes
        do i = 1, size(lattice%orders, 2)
          a(lattice%place_of(lattice%orders(:, i)), j) = beats%a(j, i)
        end do
        call transform(lattice, a(:, j), .true.)
      end do
      here = flow
      here%autonomous = .true.
      allocate (rates(points, size(moving)), p(points, size(moving), size(moving)), &
                q(points, size(moving), size(moving)))
      do i = 1, points
        do k = 1, size(flow%terms)
          here%terms(k)%coefficient = flow%terms(k)%coefficient &
                                      *exp(cmplx(0.0_wp, sum(lattice%turns(:, k) &
                                                             *lattice%angles_of(i)), wp))
        end do
        now = a(i, :)
        call here%rates(0.0_wp, now, da)
        call here%slopes(now, by_a, by_conjugate)
        rates(i, :) = da(moving)
        p(i, :, :) = by_a(moving, moving)
        q(i, :, :) = by_conjugate(moving, moving)
      end do
      do j = 1, size(moving)
        call transform(lattice, rates(:, j), .false.)
        do k = 1, size(moving)
          call transform(lattice, p(:, k, j), .false.)
          call transform(lattice, q(:, k, j), .false.)
        end do
      end do
    end associate
  end subroutine evaluate

  !> Matrix and right-hand side: real parts, then imaginary parts, order by order.
  pure subroutine fill(moving, beats, rates, p, q, matrix, x)
    integer, intent(in) :: moving(:)
    type(beating_flow_type), intent(in) :: beats
    complex(wp), intent(in) :: rates(:, :), p(:, :, :), q(:, :, :)
    real(wp), intent(out) :: matrix(:, :), x(:)
    complex(wp), dimension(size(moving), size(moving)) :: by_a, by_conjugate
    complex(wp) :: residual(size(moving))
    real(wp) :: turn
    integer :: i, k, m, n, from, to, j, row, column

    m = size(moving)
    associate (lattice => beats%lattice, orders => beats%lattice%orders)
      n = size(orders, 2)
      do i = 1, n
        turn = sum(orders(:, i)*lattice%beat)
        residual = rates(lattice%place_of(orders(:, i)), :) &
                   - cmplx(0.0_wp, turn, wp)*beats%a(moving, i)
        row = (i - 1)*m
        x(row + 1:row + m) = -real(residual)
        x(n*m + row + 1:n*m + row + m) = -aimag(residual)
        do k = 1, n
          from = lattice%place_of(orders(:, i) - orders(:, k))
          to = lattice%place_of(orders(:, i) + orders(:, k))
          by_a = p(from, :, :)
          by_conjugate = q(to, :, :)
          if (i == k) then
            do j = 1, m
              by_a(j, j) = by_a(j, j) - cmplx(0.0_wp, turn, wp)
            end do
          end if
          column = (k - 1)*m
          matrix(row + 1:row + m, column + 1:column + m) = real(by_a + by_conjugate)
          matrix(row + 1:row + m, n*m + column + 1:n*m + column + m) = aimag(by_conjugate - by_a)
          matrix(n*m + row + 1:n*m + row + m, column + 1:column + m) = aimag(by_a + by_conjugate)
          matrix(n*m + row + 1:n*m + row + m, n*m + column + 1:n*m + column + m) = &
            real(by_a - by_conjugate)
        end do
      end do
    end associate
  end subroutine fill

  !> Growth rates of perturbations of the motion.
  subroutine find_growth(flow, slowest, beats)
    type(slow_flow_type), intent(in) :: flow
    !> Decay rate of the mode with the slowest decay.
    real(wp), intent(in) :: slowest
    type(beating_flow_type), intent(inout) :: beats
    real(wp), allocatable :: columns(:, :), grown(:, :), middle(:, :), k1(:, :), k2(:, :), k3(:, :)
    real(wp), allocatable :: k4(:, :)
    complex(wp), dimension(flow%n_modes, flow%n_modes) :: by_a, by_conjugate
    real(wp) :: span, h, t, sums(2*flow%n_modes), halves(2*flow%n_modes), weight, half_weight
    integer :: i, j, n, m

    m = 2*flow%n_modes
    span = 12.0_wp/slowest
    if (beats%lattice%d > 0) then
      span = max(span, 12.0_wp*two_pi/minval(beats%lattice%beat(:beats%lattice%d)))
    end if
    allocate (grown(m, m), middle(m, m), k1(m, m), k2(m, m), k3(m, m), k4(m, m))
    call flow%slopes(spread((0.0_wp, 0.0_wp), 1, flow%n_modes), by_a, by_conjugate, 0.0_wp)
    k1 = real_matrix(by_a, by_conjugate)
    do i = 0, 31
      k2 = matrix_at(span*i/32)
      beats%fastest = max(beats%fastest, maxval(sum(abs(k2), 2)))
      beats%bent = max(beats%bent, maxval(sum(abs(k2 - k1), 2)))
    end do
    n = min(200000, max(400, ceiling(span*3.0_wp*max(beats%fastest, highest_beat(beats)))))
    h = span/n
    allocate (columns(m, m), source=0.0_wp)
    do j = 1, m
      columns(j, j) = 1.0_wp
    end do
    sums = 0.0_wp
    halves = 0.0_wp
    k4 = matrix_at(0.0_wp)
    do i = 1, n
      t = (i - 1)*h
      grown = k4
      middle = matrix_at(t + 0.5_wp*h)
      k1 = matmul(grown, columns)
      k2 = matmul(middle, columns + 0.5_wp*h*k1)
      k3 = matmul(middle, columns + 0.5_wp*h*k2)
      grown = matrix_at(t + h)
      columns = columns + (h/6.0_wp)*(k1 + 2.0_wp*(k2 + k3) + matmul(grown, columns + h*k3))
      k4 = grown
      weight = bump((i - 0.5_wp)/n)
      half_weight = bump((i - 0.5_wp)/(0.5_wp*n))
      do j = 1, m
        columns(:, j) = columns(:, j) - matmul(columns(:, :j - 1), &
                                               matmul(transpose(columns(:, :j - 1)), columns(:, j)))
        sums(j) = sums(j) + weight*log(max(norm2(columns(:, j)), tiny(1.0_wp)))
        halves(j) = halves(j) + half_weight*log(max(norm2(columns(:, j)), tiny(1.0_wp)))
        columns(:, j) = columns(:, j)/max(norm2(columns(:, j)), tiny(1.0_wp))
      end do
    end do
    beats%growth = sums/h
    beats%growth_error = abs(maxval(sums) - 2.0_wp*maxval(halves))/h
    do i = 1, m
      j = i - 1 + maxloc(beats%growth(i:), 1)
      beats%growth([i, j]) = beats%growth([j, i])
    end do

  contains

    function matrix_at(time) result(matrix)
      real(wp), intent(in) :: time
      real(wp) :: matrix(m, m)
      complex(wp), dimension(flow%n_modes, flow%n_modes) :: p, q
      call flow%slopes(amplitudes_at(beats, time), p, q, time)
      matrix(:, :) = real_matrix(p, q)
    end function matrix_at

    !> exp(-1/(x (1 - x))), divided by its sum over n points.
    real(wp) function bump(x)
      real(wp), intent(in) :: x
      real(wp), parameter :: integral = 7.0298584066096e-3_wp
      bump = 0.0_wp
      if (x > 0.0_wp .and. x < 1.0_wp) bump = exp(-1.0_wp/(x*(1.0_wp - x)))/(integral*n)
    end function bump

  end subroutine find_growth

  pure real(wp) function highest_beat(beats)
    type(beating_flow_type), intent(in) :: beats
    highest_beat = sum(beats%lattice%beat)
  end function highest_beat

end module viscovib_beating_flow
