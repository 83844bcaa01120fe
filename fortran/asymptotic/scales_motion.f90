! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> The motion for given amplitudes, and the amplitudes for a given state.
module viscovib_scales_motion
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_multiple_scales, only: multiple_scales_type
  use viscovib_slow_flow, only: turned
  use viscovib_status, only: fail, status_input_error, status_type
  implicit none
  private

  public :: motion_at, harmonic_of, amplitudes_of_state

  !> Number of sizes: three orders, and the unit.
  integer, parameter, public :: n_sizes = 4
  integer, parameter :: max_rounds = 200

contains

  !> Coordinates and velocities at time t for amplitudes a, to third order.
  subroutine motion_at(scales, t, a, q, v, sizes)
    type(multiple_scales_type), intent(in) :: scales
    real(wp), intent(in) :: t
    !> In natural units.
    complex(wp), intent(in) :: a(:)
    !> In the caller's units, shape (n_dof).
    real(wp), intent(out) :: q(:), v(:)
    !> Upper bounds of the terms of each order, as in `sizes_of`.
    real(wp), intent(out) :: sizes(n_sizes)
    complex(wp) :: y(2*scales%normal%n_generators), dy(2*scales%normal%n_generators)
    complex(wp) :: da(size(a)), wave, product, change
    real(wp) :: bounds(scales%form%n_dof, 3)
    integer :: n, m, g, d, i, k

    associate (normal => scales%normal, flow => scales%flow, form => scales%form)
      n = normal%n_modes
      g = normal%n_generators
      d = form%n_dof
      call flow%rates(t, a, da)
      do i = 1, n
        wave = turned(flow%frame(i)*t)
        y(i) = a(i)*wave
        dy(i) = (da(i) + cmplx(0.0_wp, flow%frame(i), wp)*a(i))*wave
      end do
      do i = n + 1, g
        y(i) = turned(aimag(normal%s(i))*t)
        dy(i) = normal%s(i)*y(i)
      end do
      y(g + 1:) = conjg(y(:g))
      dy(g + 1:) = conjg(dy(:g))
      q = 0.0_wp
      v = 0.0_wp
      bounds = 0.0_wp
      do i = 1, g
        q = q + 2.0_wp*real(normal%right(:d, i)*y(i))
        v = v + 2.0_wp*real(normal%right(:d, i)*dy(i))
        bounds(:, 1) = bounds(:, 1) + 2.0_wp*normal%size_one(:, i)*abs(y(i))
      end do
      do i = 1, size(normal%weak)
        k = normal%weak(i)
        wave = turned(form%drives(k)*t)
        q = q + 2.0_wp*real(normal%u_load(:d, k)*wave)
        v = v + 2.0_wp*real(normal%u_load(:d, k)*wave*cmplx(0.0_wp, form%drives(k), wp))
      end do
      do k = 1, size(normal%used_pairs)
        i = normal%used_pairs(k)
        associate (p => normal%pair(:, i), u => normal%u_pair(:d, i))
          product = y(p(1))*y(p(2))
          change = dy(p(1))*y(p(2)) + y(p(1))*dy(p(2))
          q = q + real(u*product)
          v = v + real(u*change)
          bounds(:, 2) = bounds(:, 2) + normal%size_pair(:, i)*abs(product)
        end associate
      end do
      do k = 1, size(normal%used_triples)
        m = normal%used_triples(k)
        associate (p => normal%triple(:, m), u => normal%u_triple(:d, m))
          product = y(p(1))*y(p(2))*y(p(3))
          change = dy(p(1))*y(p(2))*y(p(3)) + y(p(1))*(dy(p(2))*y(p(3)) + y(p(2))*dy(p(3)))
          q = q + real(u*product)
          v = v + real(u*change)
          bounds(:, 3) = bounds(:, 3) + normal%size_triple(:, m)*abs(product)
        end associate
      end do
      q = scales%columns(:d)*q + scales%rest(:d)
      v = scales%columns(:d)*v
      sizes = sizes_of(scales, bounds)
    end associate
  end subroutine motion_at

  !> Bound of each order in the coordinate in which it is largest. Coordinates are compared in
  !! natural units; results are in the unit of the first order, which is the last element.
  pure function sizes_of(scales, bounds) result(sizes)
    type(multiple_scales_type), intent(in) :: scales
    real(wp), intent(in) :: bounds(:, :)
    real(wp) :: sizes(n_sizes), relative(size(bounds, 1), 3), unit
    integer :: d
    d = size(bounds, 1)
    relative = bounds*spread(scales%columns(:d)/scales%units(:d), 2, 3)
    unit = scales%units(maxloc(relative(:, 1), 1))
    sizes = [maxval(relative, 1)*unit, unit]
  end function sizes_of

  !> Harmonic of a steady motion, u = Re(X exp(i p t)) + other frequencies, and the sizes of the
  !! orders; the mean for p = 0.
  pure subroutine harmonic_of(scales, a, p, x, sizes)
    type(multiple_scales_type), intent(in) :: scales
    !> In natural units.
    complex(wp), intent(in) :: a(:)
    real(wp), intent(in) :: p
    !> In the caller's units, shape (n_dof).
    complex(wp), intent(out) :: x(:)
    real(wp), intent(out) :: sizes(n_sizes)
    complex(wp) :: y(2*scales%normal%n_generators)
    real(wp) :: turn(2*scales%normal%n_generators), bounds(scales%form%n_dof, 3), margin, modulus
    real(wp) :: moduli(2*scales%normal%n_generators)
    integer :: n, g, d, i, k

    associate (normal => scales%normal, form => scales%form)
      n = normal%n_modes
      g = normal%n_generators
      d = form%n_dof
      margin = 1.0e-9_wp*p
      y(:n) = a
      y(n + 1:g) = (1.0_wp, 0.0_wp)
      y(g + 1:) = conjg(y(:g))
      moduli = abs(y)
      turn(:n) = scales%flow%frame
      turn(n + 1:g) = form%drives(normal%hard)
      turn(g + 1:) = -turn(:g)
      x = (0.0_wp, 0.0_wp)
      bounds = 0.0_wp
      do i = 1, g
        bounds(:, 1) = bounds(:, 1) + 2.0_wp*normal%size_one(:, i)*moduli(i)
        if (abs(turn(i) - p) <= margin) x = x + 2.0_wp*normal%right(:d, i)*y(i)
      end do
      do i = 1, size(normal%weak)
        k = normal%weak(i)
        if (abs(form%drives(k) - p) <= margin) x = x + 2.0_wp*normal%u_load(:d, k)
      end do
      do k = 1, size(normal%used_pairs)
        i = normal%used_pairs(k)
        associate (f => normal%pair(:, i), u => normal%u_pair(:d, i))
          modulus = moduli(f(1))*moduli(f(2))
          if (.not. modulus > 0.0_wp) cycle
          bounds(:, 2) = bounds(:, 2) + normal%size_pair(:, i)*modulus
          if (abs(turn(f(1)) + turn(f(2)) - p) > margin) cycle
          x = x + 2.0_wp*u*(y(f(1))*y(f(2)))
        end associate
      end do
      do k = 1, size(normal%used_triples)
        i = normal%used_triples(k)
        associate (f => normal%triple(:, i), u => normal%u_triple(:d, i))
          modulus = moduli(f(1))*moduli(f(2))*moduli(f(3))
          if (.not. modulus > 0.0_wp) cycle
          bounds(:, 3) = bounds(:, 3) + normal%size_triple(:, i)*modulus
          if (abs(turn(f(1)) + turn(f(2)) + turn(f(3)) - p) > margin) cycle
          x = x + 2.0_wp*u*(y(f(1))*y(f(2))*y(f(3)))
        end associate
      end do
      ! A term of frequency 0 is real: it is not doubled by a conjugate.
      if (.not. p > 0.0_wp) x = 0.5_wp*x
      x = scales%columns(:d)*x
      if (.not. p > 0.0_wp) x = x + scales%rest(:d)
      sizes = sizes_of(scales, bounds)
    end associate
  end subroutine harmonic_of

  !> Amplitudes at t = 0 of a motion that begins at (q, v), by corrections with the linear modes.
  !! The ratio of successive corrections is proportional to the amplitude.
  subroutine amplitudes_of_state(scales, q, v, a, status)
    type(multiple_scales_type), intent(in) :: scales
    !> In the caller's units.
    real(wp), intent(in) :: q(:), v(:)
    !> In natural units.
    complex(wp), intent(out) :: a(:)
    type(status_type), intent(out) :: status
    real(wp) :: matrix(2*size(q), 2*size(q)), x(2*size(q)), units(2*size(q))
    real(wp) :: q_now(size(q)), v_now(size(q)), sizes(n_sizes), error, best, whole
    integer :: pivots(2*size(q)), n, j, round
    logical :: singular

    n = size(q)
    ! Velocities divided by the highest frequency have the size of coordinates.
    units(:n) = scales%columns(:n)
    units(n + 1:) = scales%columns(:n)*maxval(abs(scales%flow%s))
    whole = maxval(abs([q, v])/units)
    do j = 1, n
      associate (r => scales%normal%right(:n, j), s => scales%normal%exponents(j))
        matrix(:n, 2*j - 1) = 2.0_wp*real(r)
        matrix(:n, 2*j) = -2.0_wp*aimag(r)
        matrix(n + 1:, 2*j - 1) = 2.0_wp*real(s*r)
        matrix(n + 1:, 2*j) = -2.0_wp*aimag(s*r)
      end associate
    end do
    matrix(n + 1:, :) = matrix(n + 1:, :)/maxval(abs(scales%flow%s))
    call factorize(2*n, matrix, pivots, singular)
    a = (0.0_wp, 0.0_wp)
    best = huge(best)
    do round = 1, merge(0, max_rounds, singular)
      call motion_at(scales, 0.0_wp, a, q_now, v_now, sizes)
      x = [q - q_now, v - v_now]/units
      error = maxval(abs(x))
      if (.not. error < huge(error)) exit
      call solve(2*n, matrix, pivots, x)
      a = a + cmplx(x(1::2), x(2::2), wp)
      if (.not. error > 1.0e-15_wp*whole) return
      ! Rounding errors: the residual does not decrease any more.
      if (round > 5 .and. error >= best .and. best <= 1.0e-12_wp*whole) return
      best = min(best, error)
    end do
    call fail(status, status_input_error, 'initial', 'initial: no amplitudes give this state; it ' &
              //'is beyond the range of the expansion')
  end subroutine amplitudes_of_state

end module viscovib_scales_motion
