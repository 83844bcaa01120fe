! Optimize: -O2 -fvect-cost-model=dynamic
!> Exponents of a periodic solution: zeros of Hill's determinant.
!!
!! The secant method on D(lambda) (1 - exp(-2 pi (a + lambda)/d))^(2n), of which the exponential
!! changes its sign where orders are odd: without memory a polynomial in 1/h, h =
!! exp(2 pi lambda/d). It starts from exponents of a solution
!! nearby, from the zeros of that polynomial, and from where memory alone would relax; where
!! those that grow are not all found then, from rates at which the system creeps away from rest,
!! and from a grid over the strip |Im lambda| <= d/2. Zeros found before are divided out, with
!! their conjugates, where it finds them again. Slow creep is found by `viscovib_hill_creep`.
module viscovib_hill_roots
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_hill_count, only: may_be_of_memory
  use viscovib_hill_creep, only: n_slow, n_strips, rates_in_strip, strip_of
  use viscovib_hill_path, only: hill_path_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_rest_growth, only: rates_from_rest
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: complete, find_exponents, find_more, follow_exponent

  !> Iterations at most, and at most since the shortest step while that is so long, in d: on a cut
  !! of D there is no zero, and steps of a few 1e-4 go to and fro.
  integer, parameter :: max_iterations = 30, patience = 6
  real(wp), parameter :: long = 3.0e-5_wp
  !> In units of d: the range of Re lambda, longest step, last step wanted and least, distance
  !! that distinguishes two exponents, distance from a line of symmetry that counts as
  !! on it.
  real(wp), parameter, public :: leftmost = -1.5_wp
  real(wp), parameter :: rightmost = 4.0_wp, longest = 0.2_wp
  real(wp), parameter :: last_step = 1.0e-8_wp, smallest_step = 1.0e-13_wp
  real(wp), parameter :: apart = 1.0e-9_wp, on_line = 1.0e-7_wp
  !> A value that has grown by this factor over a step longer than `long` gives no slope: left of
  !! where memory ends D grows by any factor, and a step back by that slope is 0 wherever it begins.
  real(wp), parameter :: grown = 1.0e3_wp
  !> Zeros so near to each other slow the secant method down unless one is divided out.
  real(wp), parameter :: twin = 1.0e-4_wp
  !> How far left approximations are bad, how near an approximation is that of an exponent.
  real(wp), parameter :: far = -0.25_wp, taken = 0.1_wp
  !> The grid of starts: real parts in units of d, and imaginary ones over [0, 1/2].
  real(wp), parameter :: grid_re(5) = [-0.02_wp, 0.05_wp, -0.15_wp, -0.4_wp, &
                                      1.0e-4_wp]
  integer, parameter :: grid_im = 4
  !> Imaginary parts, in d, from where exponents of memory are.
  real(wp), parameter :: nearby_grid(4) = [0.02_wp, 0.06_wp, 0.005_wp, 0.2_wp]

contains

  !> Exponents, largest real part first, both of conjugate pairs, with -d/2 < Im lambda <= d/2;
  !! NaN behind the last.
  subroutine find_exponents(hill, system, path, near, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    type(hill_path_type), intent(in) :: path
    !> Those of a solution nearby, NaN where there is none.
    complex(wp), intent(in) :: near(:)
    !> As many as may be kept, at least 2 n_dof.
    complex(wp), intent(out) :: exponents(:)
    integer :: n, i

    exponents = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    n = 0
    if (.not. hill%ready) return
    do i = 1, n_known(near)
      if (n >= size(exponents) - 1) exit
      if (is_slow(hill, near(i))) then
        call look_in_strip(hill, system, strip_of(hill, near(i)), exponents, n)
      else if (aimag(near(i)) >= 0.0_wp) then
        call try(hill, system, near(i), exponents, n)
      end if
    end do
    ! Skipped if all exponents of the neighbour, and as many as without memory, were found.
    if (.not. (n_known(near) > 0 .and. n >= n_known(near) &
               .and. count(.not. may_be_of_memory(hill, exponents(:n))) >= 2*hill%n_dof)) then
      call from_approximations(hill, system, path, n_known(near) == 0, exponents, n)
    end if
    call sort_falling(exponents(:n), real(exponents(:n)))
  end subroutine find_exponents

  !> More exponents, where those found are not as many as counted.
  subroutine find_more(hill, system, path, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    type(hill_path_type), intent(in) :: path
    !> NaN behind the last.
    complex(wp), intent(inout) :: exponents(:)
    integer :: n

    if (.not. hill%ready) return
    n = n_known(exponents)
    call from_approximations(hill, system, path, .false., exponents, n)
    call sort_falling(exponents(:n), real(exponents(:n)))
  end subroutine find_more

  !> More exponents, from the approximations that belong to none of those found.
  subroutine from_approximations(hill, system, path, first, exponents, n)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    type(hill_path_type), intent(in) :: path
    !> Whether no solution nearby is known.
    logical, intent(in) :: first
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    complex(wp), allocatable :: starts(:)
    integer :: i

    call path%approximations(hill, starts)
    call leave_out(hill, exponents(:n), starts)
    do i = 1, size(starts)
      if (n >= size(exponents) - 1) exit
      if (aimag(starts(i)) < 0.0_wp) cycle
      ! Those far to the left are bad approximations, and were tried at a neighbour.
      if (.not. first .and. real(starts(i)) < far*hill%period) cycle
      call try(hill, system, starts(i), exponents, n)
    end do
    if (first) call try_relaxing(hill, system, exponents, n)
    ! Some starts may have led to the same: whatever else is near these.
    call path%approximations(hill, starts)
    call leave_out(hill, exponents(:n), starts)
    do i = 1, size(starts)
      if (n >= size(exponents) - 1) exit
      if (aimag(starts(i)) < 0.0_wp) cycle
      if (n >= 2*hill%n_dof .and. real(starts(i)) < far*hill%period) cycle
      call try(hill, system, starts(i), exponents, n, nearby=.true.)
    end do
  end subroutine from_approximations

  !> Of approximations those that are left when each exponent found has taken one, nearest pairs
  !! first. Exponents nearer to where memory alone relaxes are its own and take none.
  pure subroutine leave_out(hill, found, starts)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: found(:)
    complex(wp), allocatable, intent(inout) :: starts(:)
    complex(wp) :: own(size(hill%relaxing))
    real(wp) :: distance(size(starts), size(found))
    logical :: free(size(starts)), takes(size(found))
    integer :: nearest(2), k

    free = real(starts) > leftmost*hill%period
    own = relaxing_alone(hill)
    do k = 1, size(found)
      distance(:, k) = abs(into_strip(starts - found(k), hill%period))
      takes(k) = .not. any(abs(into_strip(own - found(k), hill%period)) &
                           < minval(distance(:, k), free))
    end do
    do k = 1, size(found)
      nearest = minloc(distance, spread(free, 2, size(found)) .and. spread(takes, 1, size(starts)))
      if (any(nearest == 0)) exit
      if (distance(nearest(1), nearest(2)) > taken*hill%period) exit
      free(nearest(1)) = .false.
      takes(nearest(2)) = .false.
    end do
    starts = pack(starts, free)
  end subroutine leave_out

  !> Where memory alone would relax.
  pure function relaxing_alone(hill) result(exponents)
    type(hill_type), intent(in) :: hill
    complex(wp) :: exponents(size(hill%relaxing))
    exponents = cmplx(hill%relaxing, merge(0.5_wp*hill%period, 0.0_wp, hill%stride == 2), wp)
  end function relaxing_alone

  !> Exponents of memory itself.
  subroutine try_relaxing(hill, system, exponents, n)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    complex(wp) :: starts(size(hill%relaxing))
    integer :: i

    starts = relaxing_alone(hill)
    do i = 1, size(starts)
      if (n >= size(exponents) - 1) return
      if (real(starts(i)) > leftmost*hill%period) call try(hill, system, starts(i), exponents, n)
    end do
  end subroutine try_relaxing

  !> More exponents, from rates at which the system creeps away from rest, from what is left of
  !! approximations and, of those that grow, from a grid, until as many right of the line of a
  !! path are found as were counted.
  subroutine complete(hill, system, path, counted, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    type(hill_path_type), intent(in) :: path
    integer, intent(in) :: counted
    !> Those found, NaN behind the last; more on exit.
    complex(wp), intent(inout) :: exponents(:)
    complex(wp), allocatable :: starts(:)
    real(wp), allocatable :: rates(:)
    complex(wp) :: lambda
    real(wp) :: place
    integer :: n, i, j

    if (.not. hill%ready) return
    n = n_known(exponents)
    if (done()) return
    place = merge(0.5_wp, 0.0_wp, hill%stride == 2)
    allocate (rates(0))
    if (.not. path%shift > 0.0_wp) call rates_from_rest(system, hill%period, rates)
    do i = size(rates), 1, -1
      if (done()) exit
      lambda = cmplx(rates(i), place*hill%period, wp)
      if (is_slow(hill, lambda)) then
        call look_in_strip(hill, system, strip_of(hill, lambda), exponents, n)
      else
        call try(hill, system, lambda, exponents, n)
      end if
    end do
    ! Along the motion springs may differ from those at rest.
    if (size(rates) > 0) then
      do i = n_strips, 1, -1
        if (.not. done()) call look_in_strip(hill, system, i, exponents, n)
      end do
    end if
    call path%approximations(hill, starts)
    call leave_out(hill, exponents(:n), starts)
    ! Equal springs have exponents of memory close to each other.
    starts = [starts, pack(exponents(:n), abs(exponents(:n) - conjg(exponents(:n))) &
                           <= on_line*hill%period .or. aimag(exponents(:n)) >= 0.5_wp*hill%period)]
    do i = 1, size(starts)
      if (aimag(starts(i)) < 0.0_wp) cycle
      if (.not. done()) call try(hill, system, starts(i), exponents, n, nearby=.true.)
    end do
    ! Near the singularities of memory approximations are bad.
    do i = 1, size(nearby_grid)
      if (done()) exit
      call try(hill, system, cmplx(-0.5_wp*path%shift, &
                                   abs(place - nearby_grid(i))*hill%period, wp), exponents, n, &
               nearby=.true.)
    end do
    do i = 1, size(grid_re)
      do j = 0, grid_im
        if (done() .or. path%shift > 0.0_wp) exit
        call try(hill, system, hill%period*cmplx(grid_re(i), 0.5_wp*j/grid_im, wp), exponents, n, &
                 nearby=.true.)
      end do
    end do
    call sort_falling(exponents(:n), real(exponents(:n)))

  contains

    logical function done()
      done = n >= size(exponents) - 1 .or. count(real(exponents(:n)) > -path%shift) >= counted
    end function done

  end subroutine complete

  !> Creeps, too slowly for the secant method.
  elemental logical function is_slow(hill, exponent)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: exponent
    is_slow = strip_of(hill, exponent) > 0 .and. strip_of(hill, exponent) <= n_slow
  end function is_slow

  !> All slow rates of a strip, in the place of those that were known there.
  subroutine look_in_strip(hill, system, strip, exponents, n)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: strip
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    complex(wp), allocatable :: there(:)
    integer :: i, kept

    call rates_in_strip(hill, system, strip, there)
    kept = 0
    do i = 1, n
      if (strip_of(hill, exponents(i)) == strip) cycle
      kept = kept + 1
      exponents(kept) = exponents(i)
    end do
    n = min(kept + size(there), size(exponents))
    exponents(kept + 1:n) = there(:n - kept)
    exponents(n + 1:) = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
  end subroutine look_in_strip

  !> How many stand in front of the NaN.
  pure integer function n_known(exponents)
    complex(wp), intent(in) :: exponents(:)
    n_known = count(.not. ieee_is_nan(real(exponents)))
  end function n_known

  !> One more exponent from a start, with its conjugate.
  subroutine try(hill, system, start, exponents, n, nearby)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: start
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    !> Another than those known from the first: the start is none that is near one of its own.
    logical, intent(in), optional :: nearby
    complex(wp) :: root, rough
    logical :: made, again

    root = start
    again = is_known(twin)
    if (present(nearby)) again = again .or. (nearby .and. n > 0)
    if (.not. again) then
      call zero_near(hill, system, exponents(:0), start, root, made)
      if (.not. made) return
      again = is_known(apart)
    end if
    if (again) then
      ! Another one near those known, then made sharp as a zero of D itself.
      call zero_near(hill, system, exponents(:n), start, rough, made)
      if (.not. made) return
      root = rough
      ! A zero close to a known one is found only if the known one is divided out.
      if (.not. is_known(twin)) then
        call zero_near(hill, system, exponents(:0), rough, root, made)
        if (.not. made) return
      end if
      if (is_known(apart)) return
    end if
    n = n + 1
    exponents(n) = root
    if (aimag(root) > 0.0_wp .and. aimag(root) < 0.5_wp*hill%period) then
      n = n + 1
      exponents(n) = conjg(root)
    end if

  contains

    logical function is_known(distance)
      real(wp), intent(in) :: distance
      is_known = any(abs(exponents(:n) - root) < distance*hill%period)
    end function is_known

  end subroutine try

  !> A zero with 0 <= Im lambda <= d/2.
  subroutine zero_near(hill, system, known, start, root, made)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Those divided out.
    complex(wp), intent(in) :: known(:)
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    complex(wp) :: from

    from = start
    call secant(hill, system, known, from, root, made, sided=.true.)
    if (.not. made) return
    if (aimag(root) < -0.25_wp*hill%period .or. aimag(root) > (0.5_wp + on_line)*hill%period &
        .or. (is_upper(hill, root) .neqv. is_upper(hill, start))) then
      ! Orders reach furthest inside the strip, about the line next to it: once more.
      from = into_strip(root, hill%period)
      from = cmplx(real(from), abs(aimag(from)), wp)
      call secant(hill, system, known(:0), from, root, made, sided=.true.)
      if (.not. made) return
    end if
    root = into_strip(root, hill%period)
    root = cmplx(real(root), abs(aimag(root)), wp)
    if (aimag(root) < on_line*hill%period) root = real(root)
    if (aimag(root) > (0.5_wp - on_line)*hill%period) then
      root = cmplx(real(root), 0.5_wp*hill%period, wp)
    end if
  end subroutine zero_near

  !> Nearer to Im lambda = d/2, or -d/2, than to 0.
  pure logical function is_upper(hill, lambda)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: lambda
    is_upper = abs(aimag(lambda)) > 0.25_wp*hill%period
  end function is_upper

  !> One exponent from the place it had at a solution nearby.
  subroutine follow_exponent(hill, system, start, exponent, made)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: exponent
    logical, intent(out) :: made
    complex(wp) :: none(0)

    made = .false.
    exponent = start
    if (hill%ready) call secant(hill, system, none, start, exponent, made)
  end subroutine follow_exponent

  elemental complex(wp) function into_strip(lambda, d)
    complex(wp), intent(in) :: lambda
    real(wp), intent(in) :: d
    into_strip = cmplx(real(lambda), aimag(lambda) - d*anint(aimag(lambda)/d), wp)
  end function into_strip

  !> One more zero, those known divided out.
  subroutine secant(hill, system, known, start, root, made, sided)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: known(:), start
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    !> Not refined if its side of the axis cannot be determined.
    logical, intent(in), optional :: sided
    complex(wp) :: before, older, value_before, value, step, slope, slope_before
    real(wp) :: last, earlier, bend, error, shortest, furthest, least, poles
    integer :: i, best
    logical :: about_half

    made = .false.
    ! All the way with the same orders: with others D has another scale.
    about_half = is_upper(hill, start)
    last = huge(last)
    earlier = huge(earlier)
    shortest = huge(shortest)
    slope_before = (0.0_wp, 0.0_wp)
    best = 0
    furthest = max(rightmost*hill%period, 2.0_wp*real(start))
    ! Off the real axis, or it would never be left.
    before = start + 1.0e-4_wp*hill%period*(1.0_wp, 1.0_wp)
    older = before
    root = start
    ! The divisors vanish at -a modulo i d, or at -a + i d/2.
    poles = exp(-2.0_wp*pi*hill%shift/hill%period)*merge(-1.0_wp, 1.0_wp, hill%stride == 2)
    call reduced(before, value_before)
    least = abs(value_before)
    do i = 1, max_iterations
      call reduced(root, value)
      if (.not. abs(value) <= huge(1.0_wp)) return
      if (abs(value) > grown*abs(value_before) .and. abs(root - before) > long*hill%period) then
        root = before + 0.25_wp*(root - before)
        cycle
      end if
      slope = (value - value_before)/(root - before)
      if (.not. abs(slope) > 0.0_wp) return
      step = -value/slope
      if (.not. abs(step) <= huge(1.0_wp)) return
      if (abs(step) > longest*hill%period) step = step*(longest*hill%period/abs(step))
      bend = 1.0_wp/hill%period
      if (abs(root - older) > 0.0_wp) then
        bend = max(bend, abs((slope - slope_before)/slope/(root - older)))
      end if
      older = before
      before = root
      value_before = value
      slope_before = slope
      root = root + step
      if (real(root) < leftmost*hill%period .or. real(root) > furthest) return
      ! What the next step would be: steps go with the product of the two before and the second
      ! derivative over twice the slope. A short one back from a pole is none of these.
      error = abs(step)
      if (error < last .and. last <= rightmost*hill%period .and. abs(value) < least) then
        error = error*min(1.0_wp, last*bend)
        if (last < earlier .and. earlier <= rightmost*hill%period) then
          error = min(error, abs(step)*(abs(step)/earlier))
        end if
      end if
      least = min(least, abs(value))
      ! To rounding errors, or as far as zeros close to each other permit.
      made = error <= smallest_step*hill%period &
             .or. (abs(step) <= last_step*hill%period .and. abs(step) >= last)
      if (made) then
        ! Too close to the axis to be distinguished from it.
        if (present(sided) .and. error > smallest_step*hill%period) then
          made = .not. sided .or. abs(real(root)) > 3.0_wp*error
        end if
        return
      end if
      if (abs(step) < shortest) best = i
      shortest = min(shortest, abs(step))
      if (shortest > long*hill%period .and. i > best + patience) return
      earlier = last
      last = abs(step)
    end do

  contains

    subroutine reduced(lambda, value)
      complex(wp), intent(in) :: lambda
      complex(wp), intent(out) :: value
      complex(wp) :: z, factor
      integer :: k

      call hill%determinant(system, lambda, value, about_half)
      z = exp(-2.0_wp*pi/hill%period*lambda)
      value = value*(1.0_wp - poles*z)**(2*hill%n_dof)
      do k = 1, size(known)
        factor = 1.0_wp - exp(2.0_wp*pi/hill%period*known(k))*z
        if (abs(factor) > 0.0_wp) value = value/factor
      end do
    end subroutine reduced

  end subroutine secant

end module viscovib_hill_roots
