!> Exponents of a periodic solution: zeros of Hill's determinant.
!!
!! The secant method on D(lambda) (1 - exp(-2 pi (a + lambda)/d))^(2n), which without
!! memory is a polynomial in 1/h, h = exp(2 pi lambda/d); zeros found before are
!! divided out with their conjugates. It starts from exponents of a solution nearby,
!! then from a grid over the strip |Im lambda| <= d/2.
module viscovib_hill_roots
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: find_exponents, follow_exponent, follow_exponents, n_known

  integer, parameter :: max_iterations = 30
  !> In units of d: the range of Re lambda, longest step, last step wanted and least, distance
  !! that tells two exponents apart, distances from a line of symmetry that count as
  !! on it and near it.
  real(wp), parameter :: leftmost = -1.5_wp, rightmost = 4.0_wp, longest = 0.2_wp
  real(wp), parameter :: last_step = 1.0e-8_wp, smallest_step = 1.0e-13_wp
  real(wp), parameter :: apart = 1.0e-10_wp, on_line = 1.0e-7_wp
  real(wp), parameter :: near_line = 1.0e-3_wp
  !> The grid of starts: real parts in units of d, and imaginary ones over [0, 1/2].
  real(wp), parameter :: grid_re(5) = [-0.02_wp, 0.05_wp, -0.15_wp, -0.4_wp, &
                                      1.0e-4_wp]
  integer, parameter :: grid_im = 4

contains

  !> Those exponents that are found from the ones of a solution nearby: largest real part first,
  !! both of conjugate pairs, with -d/2 < Im lambda <= d/2; NaN behind the last.
  subroutine follow_exponents(hill, system, near, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> NaN where there is none.
    complex(wp), intent(in) :: near(:)
    !> As many as may be kept, at least 2 n_dof.
    complex(wp), intent(out) :: exponents(:)
    integer :: n, i, pass

    exponents = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    n = 0
    if (.not. hill%ready) return
    ! Twice, for two may come of one where a pair of them meets.
    do pass = 1, 2
      do i = 1, size(near)
        if (n >= min(n_known(near), size(exponents) - 1)) exit
        if (ieee_is_nan(real(near(i)))) cycle
        if (aimag(near(i)) >= 0.0_wp) call try(hill, system, near(i), exponents, n)
      end do
    end do
    call sort(exponents(:n))
  end subroutine follow_exponents

  !> More exponents beside those found: all of those with positive real part, and others down
  !! to -1.5 d; `n_growing` of `count_growing` tells whether all were found. Those with negative
  !! real part may lack some.
  subroutine find_exponents(hill, system, n_growing, n_near, turn, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> How many grow, and how many a solution nearby has, 0 if there is none.
    integer, intent(in) :: n_growing, n_near
    !> Number of the solution among its neighbours: as long as those that grow are found, and
    !! as many as nearby, a single start of the grid in turn looks for others.
    integer, intent(in) :: turn
    complex(wp), intent(inout) :: exponents(:)
    integer :: n, i, j

    if (.not. hill%ready) return
    n = n_known(exponents)
    if (n_near > 0 .and. .not. complete() .and. as_nearby()) then
      i = modulo(turn, size(grid_re)*(grid_im + 1))
      call try_grid(1 + i/(grid_im + 1), modulo(i, grid_im + 1))
    else
      do i = 1, size(grid_re)
        do j = 0, grid_im
          if (complete()) exit
          call try_grid(i, j)
        end do
      end do
    end if
    call sort(exponents(:n))

  contains

    logical function complete()
      ! Without any known nearby the whole grid is tried.
      complete = as_nearby() .and. n_near > 0 .and. n >= 2*hill%n_dof
      complete = complete .or. n >= size(exponents) - 1
    end function complete

    logical function as_nearby()
      as_nearby = n >= n_near .and. count(real(exponents(:n)) > 0.0_wp) >= n_growing
    end function as_nearby

    subroutine try_grid(i, j)
      integer, intent(in) :: i, j
      call try(hill, system, hill%period*cmplx(grid_re(i), 0.5_wp*j/grid_im, wp), exponents, n)
    end subroutine try_grid

  end subroutine find_exponents

  !> How many stand in front of the NaN.
  pure integer function n_known(exponents)
    complex(wp), intent(in) :: exponents(:)
    n_known = count(.not. ieee_is_nan(real(exponents)))
  end function n_known

  !> One more exponent from a start, with its conjugate.
  subroutine try(hill, system, start, exponents, n)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: start
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    complex(wp) :: root
    logical :: made

    call secant(hill, system, exponents(:n), start, root, made)
    if (.not. made) return
    if (abs(aimag(root)) > (0.5_wp + near_line)*hill%period) then
      ! Orders reach furthest inside the strip: once more from there.
      call secant(hill, system, exponents(:0), into_strip(root, hill%period), root, made)
      if (.not. made) return
    end if
    root = into_strip(root, hill%period)
    root = cmplx(real(root), abs(aimag(root)), wp)
    if (aimag(root) < on_line*hill%period) root = real(root)
    if (aimag(root) > (0.5_wp - near_line)*hill%period) then
      if (single(hill, system, root)) root = cmplx(real(root), 0.5_wp*hill%period, wp)
    end if
    if (any(abs(exponents(:n) - root) < apart*hill%period)) return
    n = n + 1
    exponents(n) = root
    if (aimag(root) > 0.0_wp .and. aimag(root) < 0.5_wp*hill%period) then
      n = n + 1
      exponents(n) = conjg(root)
    end if
  end subroutine try

  !> Whether a zero next to Im lambda = d/2 belongs on it: orders end unevenly about
  !! that line, which moves the zero off it, to either side. Else another zero
  !! mirrors it there.
  logical function single(hill, system, root)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: root
    complex(wp) :: here, mirrored, aside
    real(wp) :: distance
    distance = 0.5_wp*hill%period - aimag(root)
    single = distance <= on_line*hill%period
    if (single) return
    call hill%determinant(system, root, here)
    call hill%determinant(system, root + cmplx(0.0_wp, 2.0_wp*distance, wp), mirrored)
    call hill%determinant(system, root + cmplx(2.0_wp*distance, 0.0_wp, wp), aside)
    single = max(abs(here), abs(mirrored)) > 0.3_wp*abs(aside)
  end function single

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
  subroutine secant(hill, system, known, start, root, made)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: known(:), start
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    complex(wp) :: before, value_before, value, step, ratio
    real(wp) :: last
    integer :: i

    made = .false.
    last = huge(last)
    ! Off the real axis, or it would never be left.
    before = start + 1.0e-4_wp*hill%period*(1.0_wp, 1.0_wp)
    root = start
    call reduced(before, value_before)
    do i = 1, max_iterations
      call reduced(root, value)
      if (.not. abs(value) <= huge(1.0_wp)) return
      ratio = value - value_before
      if (.not. abs(ratio) > 0.0_wp) return
      step = -value*(root - before)/ratio
      if (.not. abs(step) <= huge(1.0_wp)) return
      if (abs(step) > longest*hill%period) step = step*(longest*hill%period/abs(step))
      before = root
      value_before = value
      root = root + step
      if (real(root) < leftmost*hill%period .or. real(root) > rightmost*hill%period) return
      ! To rounding, or as far as zeros side by side let it come.
      made = abs(step) <= smallest_step*hill%period &
             .or. (abs(step) <= last_step*hill%period .and. abs(step) >= last)
      if (made) return
      last = abs(step)
    end do

  contains

    subroutine reduced(lambda, value)
      complex(wp), intent(in) :: lambda
      complex(wp), intent(out) :: value
      complex(wp) :: z, factor
      integer :: k

      call hill%determinant(system, lambda, value)
      z = exp(-2.0_wp*pi/hill%period*lambda)
      value = value*(1.0_wp - exp(-2.0_wp*pi*hill%shift/hill%period)*z)**(2*hill%n_dof)
      do k = 1, size(known)
        factor = 1.0_wp - exp(2.0_wp*pi/hill%period*known(k))*z
        if (abs(factor) > 0.0_wp) value = value/factor
      end do
    end subroutine reduced

  end subroutine secant

  !> By falling real part, the members of a pair side by side.
  pure subroutine sort(z)
    complex(wp), intent(inout) :: z(:)
    complex(wp) :: next
    integer :: i, j

    do i = 2, size(z)
      next = z(i)
      j = i - 1
      do while (j > 0)
        if (real(z(j)) >= real(next)) exit
        z(j + 1) = z(j)
        j = j - 1
      end do
      z(j + 1) = next
    end do
  end subroutine sort

end module viscovib_hill_roots
