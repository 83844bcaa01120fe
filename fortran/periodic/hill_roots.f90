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
  use viscovib_hill_count, only: may_be_of_memory
  use viscovib_hill_creep, only: n_slow, n_strips, rates_from_rest, rates_in_strip, strip_of
  use viscovib_hill_determinant, only: hill_determinant, into_strip
  use viscovib_hill_path, only: hill_path_type
  use viscovib_hill_secant, only: folded, leftmost, on_line, secant, smallest_step
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: complete, find_exponents, find_more, find_near

  !> Distance that distinguishes two exponents, in d.
  real(wp), parameter :: apart = 1.0e-8_wp
  !> Zeros so near to each other slow the secant method down unless one is divided out.
  real(wp), parameter, public :: twin = 1.0e-4_wp
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
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    type(hill_path_type), intent(in) :: path
    !> Those of a solution nearby, NaN where there is none.
    complex(wp), intent(in) :: near(:)
    !> As many as may be kept, at least 2 n_dof.
    complex(wp), intent(out) :: exponents(:)
    integer :: n

    exponents = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    if (.not. hill%ready) return
    call find_near(hill, system, near, exponents)
    n = n_known(exponents)
    ! Skipped if all exponents of the neighbour, and as many as without memory, were found.
    if (.not. (n_known(near) > 0 .and. n >= n_known(near) &
               .and. count(.not. may_be_of_memory(hill, exponents(:n))) &
               >= hill%n_without_memory)) then
      call from_approximations(hill, system, path, n_known(near) == 0, exponents, n)
    end if
    call sort_falling(exponents(:n), real(exponents(:n)))
  end subroutine find_exponents

  !> More exponents, from those of a solution nearby.
  subroutine find_near(hill, system, near, exponents)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    !> NaN behind the last.
    complex(wp), intent(in) :: near(:)
    complex(wp), intent(inout) :: exponents(:)
    integer :: n, i

    n = n_known(exponents)
    do i = 1, n_known(near)
      if (n >= size(exponents) - 1) exit
      if (is_slow(hill, near(i))) then
        call look_in_strip(hill, system, strip_of(hill, near(i)), exponents, n)
      else if (aimag(near(i)) >= 0.0_wp) then
        call try(hill, system, near(i), exponents, n)
      end if
    end do
  end subroutine find_near

  !> More exponents, where those found are not as many as counted.
  subroutine find_more(hill, system, path, exponents)
    class(hill_determinant), intent(inout) :: hill
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
    class(hill_determinant), intent(inout) :: hill
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
      if (n >= hill%n_without_memory .and. real(starts(i)) < far*hill%period) cycle
      call try(hill, system, starts(i), exponents, n, nearby=.true.)
    end do
  end subroutine from_approximations

  !> Of approximations those that are left when each exponent found has taken one, nearest pairs
  !! first. Exponents nearer to where memory alone relaxes are its own and take none.
  pure subroutine leave_out(hill, found, starts)
    class(hill_determinant), intent(in) :: hill
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
    class(hill_determinant), intent(in) :: hill
    complex(wp) :: exponents(size(hill%relaxing))
    exponents = cmplx(hill%relaxing, merge(0.5_wp*hill%period, 0.0_wp, hill%stride == 2), wp)
  end function relaxing_alone

  !> Exponents of memory itself.
  subroutine try_relaxing(hill, system, exponents, n)
    class(hill_determinant), intent(inout) :: hill
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
    class(hill_determinant), intent(inout) :: hill
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
    call make_place(hill, counted - count(real(exponents(:n)) > path%line), exponents, n)
    if (done()) return
    place = merge(0.5_wp, 0.0_wp, hill%stride == 2)
    allocate (rates(0))
    if (hill%pushes .and. .not. path%line < 0.0_wp) then
      call rates_from_rest(hill, system, hill%period, rates)
    end if
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
      call try(hill, system, cmplx(0.5_wp*path%line, &
                                   abs(place - nearby_grid(i))*hill%period, wp), exponents, n, &
               nearby=.true.)
    end do
    do i = 1, size(grid_re)
      do j = 0, grid_im
        if (done() .or. path%line < 0.0_wp) exit
        call try(hill, system, hill%period*cmplx(grid_re(i), 0.5_wp*j/grid_im, wp), exponents, n, &
                 nearby=.true.)
      end do
    end do
    call sort_falling(exponents(:n), real(exponents(:n)))

  contains

    logical function done()
      done = n >= size(exponents) - 1 .or. count(real(exponents(:n)) > path%line) >= counted
    end function done

  end subroutine complete

  !> Creeps, too slowly for the secant method.
  elemental logical function is_slow(hill, exponent)
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: exponent
    is_slow = strip_of(hill, exponent) > 0 .and. strip_of(hill, exponent) <= n_slow
  end function is_slow

  !> All slow rates of a strip, in the place of those that were known there.
  subroutine look_in_strip(hill, system, strip, exponents, n)
    class(hill_determinant), intent(inout) :: hill
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

  !> Without the fastest of the exponents if they leave no place for more, conjugates together.
  pure subroutine make_place(hill, more, exponents, n)
    class(hill_determinant), intent(in) :: hill
    integer, intent(in) :: more
    !> Largest real part first, NaN behind the last.
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    integer :: kept

    kept = max(min(n, size(exponents) - 1 - more), 0)
    if (kept > 0 .and. kept < n) then
      if (abs(exponents(kept) - conjg(exponents(kept + 1))) <= apart*hill%period) kept = kept - 1
    end if
    exponents(kept + 1:n) = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    n = kept
  end subroutine make_place

  !> How many stand in front of the NaN.
  pure integer function n_known(exponents)
    complex(wp), intent(in) :: exponents(:)
    n_known = count(.not. ieee_is_nan(real(exponents)))
  end function n_known

  !> One more exponent from a start, with its conjugate.
  subroutine try(hill, system, start, exponents, n, nearby)
    class(hill_determinant), intent(inout) :: hill
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
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    !> Those divided out.
    complex(wp), intent(in) :: known(:)
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: root
    logical, intent(out) :: made

    call secant(hill, system, known, start, smallest_step, root, made, sided=.true.)
    if (.not. made) return
    if (aimag(root) < -0.25_wp*hill%period .or. aimag(root) > (0.5_wp + on_line)*hill%period &
        .or. (is_upper(hill, root) .neqv. is_upper(hill, start))) then
      ! Orders reach furthest inside the strip, about the line next to it: once more.
      call secant(hill, system, known(:0), folded(root, hill%period), smallest_step, root, made, &
                  sided=.true.)
    end if
    root = folded(root, hill%period)
  end subroutine zero_near

  !> Nearer to Im lambda = d/2, or -d/2, than to 0.
  pure logical function is_upper(hill, lambda)
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: lambda
    is_upper = abs(aimag(lambda)) > 0.25_wp*hill%period
  end function is_upper

end module viscovib_hill_roots
