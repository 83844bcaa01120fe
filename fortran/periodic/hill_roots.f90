!> Exponents of a periodic solution: zeros of Hill's determinant.
!!
!! The secant method on D(lambda) (1 - exp(-2 pi (a + lambda)/d))^(2n), which without
!! memory is a polynomial in 1/h, h = exp(2 pi lambda/d). It starts from exponents of a solution
!! nearby, from the zeros of that polynomial, and from where memory alone would relax; where
!! those that grow are not all found then, from a grid over the strip |Im lambda| <= d/2. Zeros
!! found before are divided out, with their conjugates, where it finds them again.
module viscovib_hill_roots
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_hill_path, only: hill_path_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: find_exponents, follow_exponent, search_grid

  integer, parameter :: max_iterations = 30
  !> In units of d: the range of Re lambda, longest step, last step wanted and least, distance
  !! that tells two exponents apart, distance from a line of symmetry that counts as
  !! on it.
  real(wp), parameter :: leftmost = -1.5_wp, rightmost = 4.0_wp, longest = 0.2_wp
  real(wp), parameter :: last_step = 1.0e-8_wp, smallest_step = 1.0e-13_wp
  real(wp), parameter :: apart = 1.0e-9_wp, on_line = 1.0e-7_wp
  !> How far left approximations are bad, how near an approximation is that of an exponent.
  real(wp), parameter :: far = -0.25_wp, taken = 0.1_wp
  !> How much of the stiffness remembers: starts for exponents of memory.
  real(wp), parameter :: parts(2) = [1.0_wp, 0.3_wp]
  !> The grid of starts: real parts in units of d, and imaginary ones over [0, 1/2].
  real(wp), parameter :: grid_re(5) = [-0.02_wp, 0.05_wp, -0.15_wp, -0.4_wp, &
                                      1.0e-4_wp]
  integer, parameter :: grid_im = 4

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
    complex(wp), allocatable :: starts(:)
    integer :: n, i

    exponents = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    n = 0
    if (.not. hill%ready) return
    do i = 1, n_known(near)
      if (n >= size(exponents) - 1) exit
      if (aimag(near(i)) >= 0.0_wp) call try(hill, system, near(i), exponents, n)
    end do
    call path%approximations(hill, starts)
    call leave_out(hill, exponents(:n), starts)
    do i = 1, size(starts)
      if (n >= size(exponents) - 1) exit
      if (aimag(starts(i)) < 0.0_wp) cycle
      ! Those far to the left are bad approximations, and were tried at a neighbour.
      if (n_known(near) > 0 .and. real(starts(i)) < far*hill%period) cycle
      call try(hill, system, starts(i), exponents, n)
    end do
    if (n_known(near) == 0) call try_relaxing(hill, system, exponents, n)
    if (n < 2*hill%n_dof) then
      ! Some starts have led to the same: whatever else is near these.
      call path%approximations(hill, starts)
      call leave_out(hill, exponents(:n), starts)
      do i = 1, size(starts)
        if (aimag(starts(i)) >= 0.0_wp .and. n < 2*hill%n_dof) then
          call try(hill, system, starts(i), exponents, n, beside=.true.)
        end if
      end do
    end if
    call sort(exponents(:n))
  end subroutine find_exponents

  !> Of approximations those that are left when each exponent found has taken the nearest.
  pure subroutine leave_out(hill, found, starts)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: found(:)
    complex(wp), allocatable, intent(inout) :: starts(:)
    logical :: free(size(starts))
    real(wp) :: distance(size(starts))
    integer :: i, k

    free = real(starts) > leftmost*hill%period
    do i = 1, size(found)
      if (.not. any(free)) exit
      distance = abs(into_strip(starts - found(i), hill%period))
      k = minloc(distance, 1, free)
      if (distance(k) < taken*hill%period) free(k) = .false.
    end do
    starts = pack(starts, free)
  end subroutine leave_out

  !> Exponents of memory itself: next to a rate at which it fades, -r, where what a kernel R
  !! leaves of a spring, 1 - R(s), vanishes, or somewhat left of it if other springs remember
  !! less. They are real, or at i d/2 where orders are odd.
  subroutine try_relaxing(hill, system, exponents, n)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    complex(wp) :: start
    real(wp) :: s
    integer :: i, q
    logical :: made

    do q = 1, size(system%kernels)
      if (.not. any(system%kernel_of == q)) cycle
      do i = 1, merge(1, size(parts), all(system%kernel_of == q))
        if (n >= size(exponents) - 1) return
        call relaxing(system, q, parts(i), -leftmost*hill%period, s, made)
        if (.not. made) exit
        start = cmplx(s, merge(0.5_wp*hill%period, 0.0_wp, hill%stride == 2), wp)
        call try(hill, system, start, exponents, n)
      end do
    end do
  end subroutine try_relaxing

  !> Where part R(s) = 1 at real s, 0 > s > -range: R grows from s = 0 to its first singularity, and
  !! is no positive real number behind it.
  subroutine relaxing(system, q, part, range, s, made)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: q
    real(wp), intent(in) :: part, range
    real(wp), intent(out) :: s
    logical, intent(out) :: made
    complex(wp) :: r(1)
    real(wp) :: low, high, last
    integer :: i

    made = .false.
    s = 0.0_wp
    if (.not. system%kernels(q)%kernel%integral() < 1.0_wp/(part*system%memory_scale)) return
    ! Above the root at low, below it, or behind the singularity, at high.
    low = 0.0_wp
    high = 0.0_wp
    last = 0.0_wp
    s = 1.0e-12_wp*range
    do while (s < range)
      call system%kernels(q)%kernel%laplace([cmplx(-s, 0.0_wp, wp)], r)
      if (beyond()) then
        high = s
        exit
      end if
      last = real(r(1))
      low = s
      s = 2.0_wp*s
    end do
    if (.not. high > 0.0_wp) return
    do i = 1, 60
      s = 0.5_wp*(low + high)
      call system%kernels(q)%kernel%laplace([cmplx(-s, 0.0_wp, wp)], r)
      if (beyond()) then
        high = s
      else
        low = s
        last = real(r(1))
      end if
      if (high - low <= 1.0e-14_wp*high) exit
    end do
    s = -low
    made = .true.

  contains

    logical function beyond()
      beyond = .true.
      if (.not. abs(r(1)) <= huge(1.0_wp)) return
      if (abs(aimag(r(1))) > 1.0e-12_wp*abs(real(r(1)))) return
      beyond = real(r(1)) < last .or. real(r(1))*part*system%memory_scale > 1.0_wp
    end function beyond

  end subroutine relaxing

  !> More exponents from a grid, until as many that grow are found as were counted.
  subroutine search_grid(hill, system, n_growing, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: n_growing
    !> Those found, NaN behind the last; more on exit.
    complex(wp), intent(inout) :: exponents(:)
    integer :: n, i, j

    if (.not. hill%ready) return
    n = n_known(exponents)
    do i = 1, size(grid_re)
      do j = 0, grid_im
        if (n >= size(exponents) - 1) exit
        if (count(real(exponents(:n)) > 0.0_wp) >= n_growing) exit
        call try(hill, system, hill%period*cmplx(grid_re(i), 0.5_wp*j/grid_im, wp), exponents, n, &
                 beside=.true.)
      end do
    end do
    call sort(exponents(:n))
  end subroutine search_grid

  !> How many stand in front of the NaN.
  pure integer function n_known(exponents)
    complex(wp), intent(in) :: exponents(:)
    n_known = count(.not. ieee_is_nan(real(exponents)))
  end function n_known

  !> One more exponent from a start, with its conjugate.
  subroutine try(hill, system, start, exponents, n, beside)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: start
    complex(wp), intent(inout) :: exponents(:)
    integer, intent(inout) :: n
    !> Another than those known from the first: the start is none that is near one of its own.
    logical, intent(in), optional :: beside
    complex(wp) :: root, rough
    logical :: made, again

    root = start
    again = .false.
    if (present(beside)) again = beside .and. n > 0
    if (.not. again) then
      call zero_near(hill, system, exponents(:0), start, root, made)
      if (.not. made) return
      again = is_known()
    end if
    if (again) then
      ! Another one beside those known, then made sharp as a zero of D itself.
      call zero_near(hill, system, exponents(:n), start, rough, made)
      if (.not. made) return
      call zero_near(hill, system, exponents(:0), rough, root, made)
      if (.not. made) return
      if (is_known()) return
    end if
    n = n + 1
    exponents(n) = root
    if (aimag(root) > 0.0_wp .and. aimag(root) < 0.5_wp*hill%period) then
      n = n + 1
      exponents(n) = conjg(root)
    end if

  contains

    logical function is_known()
      is_known = any(abs(exponents(:n) - root) < apart*hill%period)
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
    !> Not made where it cannot be told on which side of the axis it is.
    logical, intent(in), optional :: sided
    complex(wp) :: before, value_before, value, step, ratio
    real(wp) :: last
    integer :: i
    logical :: about_half

    made = .false.
    ! All the way with the same orders: with others D has another scale.
    about_half = is_upper(hill, start)
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
      if (made) then
        ! Closer to the axis than to be told from it.
        if (present(sided) .and. abs(step) > smallest_step*hill%period) then
          made = .not. sided .or. abs(real(root)) > 3.0_wp*abs(step)
        end if
        return
      end if
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
