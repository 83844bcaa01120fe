! Optimize: -O2
!> The part of a linear subsystem without real modes, over one step: z_m' = pole_m z_m + p_m,
!! w_j = Re sum_m left_mj z_m, with one pole of each conjugate pair.
!!
!!   z(c h) = exp(pole c h) z(0) + integral_0^(c h) exp(pole (c h - t)) p(t) dt,
!!   p_m = sum_l right_ml f_l(t) + sum_k (sine_mk sin nu_k t + cosine_mk cos nu_k t),
!!
!! f_l polynomials through the nodes as in `viscovib_modal_maps`. The last `n_at_once` variables
!! are massless (instantaneous): z_m = p_m. Their rates are those of p_m, from the polynomials.
module viscovib_pole_maps
  use viscovib_collocation, only: collocation_type
  use viscovib_kinds, only: wp
  use viscovib_section_step, only: grown, legendre_moments, slope_of_growth
  implicit none
  private

  public :: add_pole_points, new_pole_map, move_poles, pole_gain, pole_map_type, pole_rates
  public :: pole_wave, poles_type, rates_at_once, seen_at_once, seen_of_poles, slopes_of_nodes
  public :: wave_at_once

  type :: poles_type
    !> Shape (n) (1/s).
    complex(wp), allocatable :: poles(:)
    !> Output and input coefficients, shapes (n, n_seen) and (n, n_pushed).
    complex(wp), allocatable :: left(:, :), right(:, :)
    !> Forcing by harmonic loads, shape (n, n_waves).
    complex(wp), allocatable :: sine(:, :), cosine(:, :)
    !> Change due to a jump of the base and of its velocity, shape (n).
    complex(wp), allocatable :: by_base(:), by_base_rate(:)
    !> Number of instantaneous variables, the last ones.
    integer :: n_at_once = 0
  end type poles_type

  type :: pole_map_type
    !> Gains by the state at the nodes and the end, shape (n, s+1); gains at the end by forces at
    !! the nodes, shape (n, s).
    complex(wp), allocatable :: by_z(:, :), gain(:, :)
    !> Slopes at the end of polynomials of unit value at one node, shape (s).
    real(wp), allocatable :: slope(:)
  end type pole_map_type

contains

  !> The maps, and their contributions to the maps of the deflections and of harmonic loads: rows
  !! (j-1)(s+1)+p, and in `swing` at the end rows of Re z, then of Im z, then of the rates of
  !! instantaneous variables.
  subroutine new_pole_map(map, poles, frequencies, coefficients, table, h, answer, swing)
    type(pole_map_type), intent(out) :: map
    type(poles_type), intent(in) :: poles
    real(wp), intent(in) :: frequencies(:)
    !> From `legendre_of_nodes` at the nodes and the end, shape (s, s, s+1).
    real(wp), intent(in) :: coefficients(:, :, :)
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h
    real(wp), intent(inout) :: answer(:, :)
    complex(wp), intent(inout) :: swing(:, :)
    complex(wp) :: gain(table%s), waved(2)
    real(wp) :: now
    integer :: j, k, l, m, n, p, row, s
    logical :: follows

    s = table%s
    n = size(poles%poles)
    allocate (map%by_z(n, s + 1), map%gain(n, s))
    map%slope = slopes_of_nodes(table, 1.0_wp)/h
    do p = 1, s + 1
      now = table%points(p)*h
      do m = 1, n
        follows = m > n - poles%n_at_once
        if (follows) then
          map%by_z(m, p) = (-1.0_wp, 0.0_wp)
          gain = sum(coefficients(:, :, p), 1)
        else
          map%by_z(m, p) = grown(poles%poles(m)*now)
          call pole_gain(poles%poles(m), now, coefficients(:, :, p), gain)
        end if
        if (p > s) map%gain(m, :) = gain
        do j = 1, size(poles%left, 2)
          row = (j - 1)*(s + 1) + p
          do l = 1, size(poles%right, 2)
            answer(row, (l - 1)*s + 1:l*s) = answer(row, (l - 1)*s + 1:l*s) &
                                             + real(poles%left(m, j)*poles%right(m, l)*gain)
          end do
        end do
        do k = 1, size(frequencies)
          if (follows) then
            waved = wave_at_once(frequencies(k)*now, poles%sine(m, k), poles%cosine(m, k))
          else
            waved = pole_wave(poles%poles(m), frequencies(k), now, poles%sine(m, k), &
                              poles%cosine(m, k))
          end if
          do j = 1, size(poles%left, 2)
            row = (j - 1)*(s + 1) + p
            swing(row, k) = swing(row, k) + cmplx(real(poles%left(m, j)*waved(1)), &
                                                  real(poles%left(m, j)*waved(2)), wp)
          end do
          if (p <= s) cycle
          row = size(swing, 1) - poles%n_at_once - 2*n + m
          swing(row, k) = cmplx(real(waved(1)), real(waved(2)), wp)
          swing(row + n, k) = cmplx(aimag(waved(1)), aimag(waved(2)), wp)
          if (.not. follows) cycle
          waved = frequencies(k)*wave_at_once(frequencies(k)*now, -poles%cosine(m, k), &
                                              poles%sine(m, k))
          swing(row + n + poles%n_at_once, k) = cmplx(real(waved(1)), real(waved(2)), wp)
        end do
      end do
    end do
  end subroutine new_pole_map

  !> Gains by polynomials of unit value at one node, over a time `now`.
  pure subroutine pole_gain(pole, now, coefficients, gain)
    complex(wp), intent(in) :: pole
    real(wp), intent(in) :: now, coefficients(:, :)
    complex(wp), intent(out) :: gain(:)
    complex(wp) :: moments(size(gain))
    call legendre_moments(pole*now, moments)
    gain = now*matmul(moments, coefficients)
  end subroutine pole_gain

  !> Response to sine sin(nu t + phi) + cosine cos(nu t + phi): factors of sin phi and of cos phi.
  pure function pole_wave(pole, nu, now, sine, cosine) result(waved)
    complex(wp), intent(in) :: pole, sine, cosine
    real(wp), intent(in) :: nu, now
    complex(wp) :: waved(2), ahead, back, of_cosine, of_sine
    ahead = now*slope_of_growth(cmplx(0.0_wp, nu*now, wp), pole*now)
    back = now*slope_of_growth(cmplx(0.0_wp, -nu*now, wp), pole*now)
    of_cosine = 0.5_wp*(ahead + back)
    of_sine = (0.0_wp, -0.5_wp)*(ahead - back)
    waved = [sine*of_cosine - cosine*of_sine, sine*of_sine + cosine*of_cosine]
  end function pole_wave

  !> The same for instantaneous variables, x = nu t: sine sin(x + phi) + cosine cos(x + phi).
  pure function wave_at_once(x, sine, cosine) result(waved)
    real(wp), intent(in) :: x
    complex(wp), intent(in) :: sine, cosine
    complex(wp) :: waved(2)
    waved = [sine*cos(x) - cosine*sin(x), sine*sin(x) + cosine*cos(x)]
  end function wave_at_once

  !> Slopes at x of the polynomials of unit value at one node of a step of unit length.
  pure function slopes_of_nodes(table, x) result(slopes)
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: x
    real(wp) :: slopes(table%s), product
    integer :: i, j, k

    slopes = 0.0_wp
    associate (c => table%points(1:table%s))
      do i = 1, table%s
        do j = 1, table%s
          if (j == i) cycle
          product = 1.0_wp/(c(i) - c(j))
          do k = 1, table%s
            if (k /= i .and. k /= j) product = product*(x - c(k))/(c(i) - c(k))
          end do
          slopes(i) = slopes(i) + product
        end do
      end do
    end associate
  end function slopes_of_nodes

  !> Add the change of deflections due to the state alone, at each point, to a.
  pure subroutine add_pole_points(map, poles, z, a)
    type(pole_map_type), intent(in) :: map
    type(poles_type), intent(in) :: poles
    complex(wp), intent(in) :: z(:)
    !> Point p of deflection j at (j-1)(s+1)+p.
    real(wp), intent(inout) :: a(:)
    complex(wp) :: gained(size(z))
    integer :: j, p, n_points
    if (size(z) == 0) return
    n_points = size(map%by_z, 2)
    do p = 1, n_points
      gained = map%by_z(:, p)*z
      do j = 1, size(poles%left, 2)
        a((j - 1)*n_points + p) = a((j - 1)*n_points + p) + seen_of_poles(poles%left(:, j), gained)
      end do
    end do
  end subroutine add_pole_points

  !> Re sum left z.
  pure real(wp) function seen_of_poles(left, z)
    complex(wp), intent(in) :: left(:), z(:)
    seen_of_poles = sum(real(left)*real(z) - aimag(left)*aimag(z))
  end function seen_of_poles

  !> Re sum left pole z: the instantaneous contributions of forces to a rate cancel.
  pure real(wp) function pole_rates(left, poles, z)
    complex(wp), intent(in) :: left(:), poles(:), z(:)
    pole_rates = seen_of_poles(left, poles*z)
  end function pole_rates

  !> Contribution of instantaneous variables to an observed rate.
  pure real(wp) function seen_at_once(left, rates)
    complex(wp), intent(in) :: left(:)
    !> Of the last of `left`.
    real(wp), intent(in) :: rates(:)
    seen_at_once = sum(real(left(size(left) - size(rates) + 1:))*rates)
  end function seen_at_once

  !> Rates of instantaneous variables at x, relative to a step of length h, due to forces at the
  !! nodes, shape (s, n_pushed), and harmonic loads with phases phi there.
  pure subroutine rates_at_once(poles, table, frequencies, x, h, forces, phi, rates)
    type(poles_type), intent(in) :: poles
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: frequencies(:), x, h, forces(:, :), phi(:)
    real(wp), intent(out) :: rates(:)
    real(wp) :: push(size(forces, 2))
    integer :: i, m

    push = matmul(slopes_of_nodes(table, x), forces)/h
    do i = 1, size(rates)
      m = size(poles%poles) - size(rates) + i
      rates(i) = sum(real(poles%right(m, :))*push) &
                 + sum(frequencies*(real(poles%sine(m, :))*cos(phi) &
                                    - real(poles%cosine(m, :))*sin(phi)))
    end do
  end subroutine rates_at_once

  !> Advance to the end of the step, with compensated sums.
  pure subroutine move_poles(map, poles, forces, swing, z, rest, rates, finite)
    type(pole_map_type), intent(in) :: map
    type(poles_type), intent(in) :: poles
    !> Shape (s, n_pushed); rows of Re z, Im z and the rates of instantaneous variables, or none.
    real(wp), intent(in) :: forces(:, :), swing(:)
    complex(wp), intent(inout) :: z(:), rest(:)
    !> Rates of instantaneous variables.
    real(wp), intent(inout) :: rates(:)
    logical, intent(out) :: finite
    complex(wp) :: gained(size(z)), total
    real(wp) :: push(size(forces, 2))
    integer :: i, k, m, n

    finite = .true.
    n = size(z)
    if (n == 0) return
    gained = rest + map%by_z(:, size(map%by_z, 2))*z
    if (size(swing) > 0) gained = gained + cmplx(swing(:n), swing(n + 1:2*n), wp)
    do k = 1, size(map%gain, 2)
      gained = gained + map%gain(:, k)*matmul(poles%right, forces(k, :))
    end do
    finite = sum(abs(real(gained)) + abs(aimag(gained))) <= huge(1.0_wp)
    if (.not. finite) return
    do m = 1, n
      total = z(m) + gained(m)
      rest(m) = (z(m) - (total - (total - z(m)))) + (gained(m) - (total - z(m)))
      z(m) = total
    end do
    if (size(rates) == 0) return
    push = matmul(map%slope, forces)
    do i = 1, size(rates)
      rates(i) = sum(real(poles%right(n - size(rates) + i, :))*push)
      if (size(swing) > 0) rates(i) = rates(i) + swing(2*n + i)
    end do
  end subroutine move_poles

end module viscovib_pole_maps
