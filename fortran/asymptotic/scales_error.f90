!> The error of a motion by multiple scales to leading order: the correction by its defect
!! (`viscovib_motion_defect`), with amplitudes by the linearised modulation equations
!! d(da)/dt = P da + Q conj(da) + rho(t), where rho is the contribution of the defect to each
!! mode. For a steady motion, 0 = P da + Q conj(da) + rho.
module viscovib_scales_error
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_motion_defect, only: defect_type, find_defect
  use viscovib_multiple_scales, only: multiple_scales_type
  use viscovib_polynomial_form, only: full_system_type
  use viscovib_scales_motion, only: harmonic_of, n_sizes
  use viscovib_slow_flow, only: real_matrix
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: steady_error, motion_errors

contains

  !> Errors of a steady motion in the caller's units; infinite if they cannot be computed.
  subroutine steady_error(scales, full, a, p, of_harmonic, of_motion)
    type(multiple_scales_type), intent(in) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    !> Amplitudes in natural units; a frequency.
    complex(wp), intent(in) :: a(:)
    real(wp), intent(in) :: p
    !> Error of the harmonic of p, and of the sum over all frequencies, shape (n_dof).
    real(wp), intent(out) :: of_harmonic(:), of_motion(:)
    type(defect_type) :: defect
    complex(wp) :: rho(size(a)), change(size(a))
    complex(wp), dimension(size(of_harmonic)) :: harmonic, before, after
    real(wp) :: margin, sizes(n_sizes)
    integer :: d, i, j
    logical :: singular

    d = size(of_harmonic)
    of_harmonic = ieee_value(1.0_wp, ieee_positive_inf)
    of_motion = ieee_value(1.0_wp, ieee_positive_inf)
    margin = 1.0e-7_wp
    ! Only terms that are constant in a mode's frame change its amplitude. For a near term the
    ! mode's dynamic stiffness determines the response; quadratic terms act back on the mode.
    call find_defect(scales, full, a, defect, margin)
    if (.not. defect%known) return
    associate (frame => scales%flow%frame, normal => scales%normal)
      rho = (0.0_wp, 0.0_wp)
      do i = 1, defect%n
        do j = 1, size(a)
          if (abs(defect%frequency(i) - frame(j)) <= margin*frame(j)) then
            rho(j) = rho(j) + defect%rates(j, i)
          end if
        end do
      end do
      call steady_change(scales, a, rho, change, singular)
      if (singular) return
      harmonic = (0.0_wp, 0.0_wp)
      of_motion = 0.0_wp
      do i = 1, defect%n
        of_motion = of_motion + 2.0_wp*abs(defect%u(:d, i))
        if (abs(defect%frequency(i) - p) <= margin*p) harmonic = harmonic + 2.0_wp*defect%u(:d, i)
      end do
      do j = 1, size(a)
        of_motion = of_motion + 2.0_wp*abs(normal%right(:d, j)*change(j))
      end do
    end associate
    ! Products change with the amplitudes.
    call harmonic_of(scales, a, p, before, sizes)
    call harmonic_of(scales, a + change, p, after, sizes)
    of_harmonic = abs(scales%columns(:d)*harmonic + (after - before))
    of_motion = scales%columns(:d)*of_motion
  end subroutine steady_error

  !> Solve P da + Q conj(da) = -rho for the modes that are active or excited.
  subroutine steady_change(scales, a, rho, change, singular)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: a(:), rho(:)
    complex(wp), intent(out) :: change(:)
    logical, intent(out) :: singular
    complex(wp), dimension(size(a), size(a)) :: p, q
    real(wp), allocatable :: matrix(:, :), x(:)
    integer, allocatable :: which(:), pivots(:)
    integer :: j, m

    change = (0.0_wp, 0.0_wp)
    singular = .false.
    which = pack([(j, j=1, size(a))], abs(a) > 0.0_wp .or. abs(rho) > 0.0_wp)
    m = size(which)
    if (m == 0) return
    call scales%flow%slopes(a, p, q)
    allocate (matrix(2*m, 2*m), x(2*m), pivots(2*m))
    matrix(:, :) = real_matrix(p(which, which), q(which, which))
    x(:m) = -real(rho(which))
    x(m + 1:) = -aimag(rho(which))
    call factorize(2*m, matrix, pivots, singular)
    if (singular) return
    call solve(2*m, matrix, pivots, x)
    change(which) = cmplx(x(:m), x(m + 1:), wp)
  end subroutine steady_change

  !> Errors at given times of a motion that starts in a given state. Initial amplitudes are
  !! corrected by the defect of the expansion at the first time.
  subroutine motion_errors(scales, full, times, a, errors, cancel)
    type(multiple_scales_type), intent(in) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    !> Ascending, and close enough for the amplitudes, shape (n_modes, n), in natural units, to
    !! be interpolated by cubics.
    real(wp), intent(in) :: times(:)
    complex(wp), intent(in) :: a(:, :)
    !> Error of each coordinate, in the caller's units, shape (n_dof, n).
    real(wp), intent(out) :: errors(:, :)
    integer, intent(inout) :: cancel
    type(defect_type) :: here, next
    complex(wp) :: change(size(a, 1)), slope(size(a, 1), 2)
    real(wp) :: turns(size(a, 1))
    integer :: i

    errors = ieee_value(1.0_wp, ieee_positive_inf)
    call find_turns(scales, times, a, turns)
    call find_defect(scales, full, a(:, 1), here, turns=turns)
    if (.not. here%known) return
    change = first_change(scales, here, times(1), size(errors, 1))
    errors(:, 1) = size_of_error(scales, here, change, size(errors, 1))
    do i = 2, size(times)
      if (is_set(cancel)) return
      call find_defect(scales, full, a(:, i), next, turns=turns)
      if (.not. next%known) return
      call scales%flow%rates(times(i - 1), a(:, i - 1), slope(:, 1))
      call scales%flow%rates(times(i), a(:, i), slope(:, 2))
      call carry(scales, here, next, times(i - 1:i), a(:, i - 1:i), slope, change)
      errors(:, i) = size_of_error(scales, next, change, size(errors, 1))
      call move_defect(next, here)
    end do
  end subroutine motion_errors

  !> Mean frequencies of amplitudes in their frame: Im(conj(a) a')/|a|^2 with weights |a|^2. They
  !! lie between 0, for constant amplitudes, and those of free modes. The frame may be far from
  !! the natural frequencies, for example if w1 ~ 2 w2 is one of several resonances.
  subroutine find_turns(scales, times, a, turns)
    type(multiple_scales_type), intent(in) :: scales
    real(wp), intent(in) :: times(:)
    complex(wp), intent(in) :: a(:, :)
    real(wp), intent(out) :: turns(:)
    complex(wp) :: slope(size(a, 1))
    real(wp) :: weight(size(a, 1)), own
    integer :: i, j

    turns = 0.0_wp
    weight = 0.0_wp
    do i = 1, size(times)
      call scales%flow%rates(times(i), a(:, i), slope)
      turns = turns + aimag(conjg(a(:, i))*slope)
      weight = weight + abs(a(:, i))**2
    end do
    do j = 1, size(turns)
      own = aimag(scales%flow%s(j)) - scales%flow%frame(j)
      turns(j) = turns(j)/max(weight(j), tiny(1.0_wp))
      turns(j) = max(min(turns(j), max(own, 0.0_wp)), min(own, 0.0_wp))
    end do
  end subroutine find_turns

  subroutine move_defect(from, to)
    type(defect_type), intent(inout) :: from, to
    to%n = from%n
    call move_alloc(from%frequency, to%frequency)
    call move_alloc(from%phase_rate, to%phase_rate)
    call move_alloc(from%u, to%u)
    call move_alloc(from%rates, to%rates)
  end subroutine move_defect

  !> Solve sum_j 2 Re r_j da_j = -(sum of the terms) for coordinates and velocities.
  function first_change(scales, defect, t, d) result(change)
    type(multiple_scales_type), intent(in) :: scales
    type(defect_type), intent(in) :: defect
    real(wp), intent(in) :: t
    integer, intent(in) :: d
    complex(wp) :: change(scales%flow%n_modes)
    complex(wp) :: wave
    real(wp) :: matrix(2*d, 2*d), x(2*d)
    integer :: pivots(2*d), i, j
    logical :: singular

    x = 0.0_wp
    do i = 1, defect%n
      wave = exp(cmplx(0.0_wp, defect%phase_rate(i)*t, wp))
      x(:d) = x(:d) - 2.0_wp*real(defect%u(:d, i)*wave)
      x(d + 1:) = x(d + 1:) &
                  - 2.0_wp*real(defect%u(:d, i)*wave*cmplx(0.0_wp, defect%frequency(i), wp))
    end do
    do j = 1, d
      associate (r => scales%normal%right(:d, j)*exp(cmplx(0.0_wp, scales%flow%frame(j)*t, wp)), &
                 s => cmplx(0.0_wp, scales%flow%frame(j), wp))
        matrix(:d, 2*j - 1) = 2.0_wp*real(r)
        matrix(:d, 2*j) = -2.0_wp*aimag(r)
        matrix(d + 1:, 2*j - 1) = 2.0_wp*real(s*r)
        matrix(d + 1:, 2*j) = -2.0_wp*aimag(s*r)
      end associate
    end do
    call factorize(2*d, matrix, pivots, singular)
    change = (0.0_wp, 0.0_wp)
    if (singular) return
    call solve(2*d, matrix, pivots, x)
    change = cmplx(x(1::2), x(2::2), wp)
  end function first_change

  !> Sum of the moduli of modes, and root sum of squares of the Fourier terms.
  pure function size_of_error(scales, defect, change, d) result(size_of)
    type(multiple_scales_type), intent(in) :: scales
    type(defect_type), intent(in) :: defect
    complex(wp), intent(in) :: change(:)
    integer, intent(in) :: d
    real(wp) :: size_of(d)
    integer :: i
    size_of = 0.0_wp
    do i = 1, defect%n
      size_of = size_of + 2.0_wp*abs(defect%u(:d, i))**2
    end do
    size_of = sqrt(size_of)
    do i = 1, size(change)
      size_of = size_of + 2.0_wp*abs(scales%normal%right(:d, i)*change(i))
    end do
    size_of = scales%columns(:d)*size_of
  end function size_of_error

  !> One step between two times by the classical Runge-Kutta method.
  subroutine carry(scales, here, next, times, a, slope, change)
    type(multiple_scales_type), intent(in) :: scales
    type(defect_type), intent(in) :: here, next
    real(wp), intent(in) :: times(2)
    complex(wp), intent(in) :: a(:, :), slope(:, :)
    complex(wp), intent(inout) :: change(:)
    complex(wp), dimension(size(change)) :: k1, k2, k3, k4
    real(wp) :: h, t, fastest
    integer :: i, n, j

    fastest = 0.0_wp
    do j = 1, size(change)
      do i = 1, here%n
        if (abs(here%rates(j, i)) > 0.0_wp) then
          fastest = max(fastest, abs(here%phase_rate(i) - scales%flow%frame(j)))
        end if
      end do
      fastest = max(fastest, abs(scales%flow%s(j) - cmplx(0.0_wp, scales%flow%frame(j), wp)))
    end do
    n = min(1 + int(3.0_wp*fastest*(times(2) - times(1))), 10000)
    h = (times(2) - times(1))/n
    do i = 1, n
      t = times(1) + (i - 1)*h
      k1 = speed(t, change)
      k2 = speed(t + 0.5_wp*h, change + 0.5_wp*h*k1)
      k3 = speed(t + 0.5_wp*h, change + 0.5_wp*h*k2)
      k4 = speed(t + h, change + h*k3)
      change = change + (h/6.0_wp)*(k1 + 2.0_wp*(k2 + k3) + k4)
    end do

  contains

    function speed(t, x) result(value)
      real(wp), intent(in) :: t
      complex(wp), intent(in) :: x(:)
      complex(wp) :: value(size(x)), now(size(x)), p(size(x), size(x)), q(size(x), size(x))
      real(wp) :: part
      integer :: w, m
      part = (t - times(1))/(times(2) - times(1))
      now = hermite(part, times(2) - times(1), a(:, 1), slope(:, 1), a(:, 2), slope(:, 2))
      call scales%flow%slopes(now, p, q, t)
      value = matmul(p, x) + matmul(q, conjg(x))
      do w = 1, here%n
        do m = 1, size(x)
          if (.not. abs(here%rates(m, w)) + abs(next%rates(m, w)) > 0.0_wp) cycle
          value(m) = value(m) + ((1.0_wp - part)*here%rates(m, w) + part*next%rates(m, w)) &
                     *exp(cmplx(0.0_wp, (here%phase_rate(w) - scales%flow%frame(m))*t, wp))
        end do
      end do
    end function speed

  end subroutine carry

  pure function hermite(x, h, from, slope_from, to, slope_to) result(value)
    real(wp), intent(in) :: x, h
    complex(wp), intent(in) :: from(:), slope_from(:), to(:), slope_to(:)
    complex(wp) :: value(size(from))
    value = (1.0_wp - x)**2*((1.0_wp + 2.0_wp*x)*from + x*h*slope_from) &
            + x**2*((3.0_wp - 2.0_wp*x)*to - (1.0_wp - x)*h*slope_to)
  end function hermite

end module viscovib_scales_error
