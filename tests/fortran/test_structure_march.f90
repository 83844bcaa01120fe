!> Structures in time: modal sections over a step against known motions.
module test_structure_march
  use testing, only: begin, check, check_close
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: gauss_nodes, legendre
  use viscovib_section_step, only: driven_section, free_section, legendre_moments, &
    relaxing_section, section_wave
  implicit none
  private

  public :: run_structure_march

  !> Frequencies and damping ratios of modal sections over a unit of time.
  real(wp), parameter :: omegas(9) = [1.0e-8_wp, 1.0e-3_wp, 0.7_wp, 1.4_wp, 3.14_wp, 20.0_wp, &
                                      62.0_wp, 500.0_wp, 1.0e4_wp]
  real(wp), parameter :: ratios(8) = [0.0_wp, 1.0e-6_wp, 0.02_wp, 0.999999_wp, 1.0_wp, &
                                      1.000001_wp, 3.0_wp, 1.0e3_wp]

contains

  subroutine run_structure_march()
    if (begin('polynomial motions of sections')) call polynomial_motions()
    if (begin('sections that relax')) call relaxing()
    if (begin('waves of sections')) call waves()
    if (begin('free sections in two halves')) call halves()
    if (begin('moments of exponentials')) call moments()
  end subroutine run_structure_march

  !> q = 1 + 2 t - t^2 + t^5/2 is the response to the load q'' + rate q' + square q.
  subroutine polynomial_motions()
    real(wp) :: by_order(0:7), rates(0:7), by_q(2), by_v(2), square, rate
    integer :: i, j
    do i = 1, size(omegas)
      do j = 1, size(ratios)
        square = omegas(i)**2
        rate = 2.0_wp*ratios(j)*omegas(i)
        call one(square, rate)
        ! Negative stiffness, and none.
        if (omegas(i) < 5.0_wp) call one(-square, rate)
        call one(0.0_wp, rate)
      end do
    end do

  contains

    subroutine one(square, rate)
      real(wp), intent(in) :: square, rate
      real(wp) :: forces(0:7), t(8), w(8), f, size_of
      integer :: k, order
      call free_section(square, rate, by_q, by_v)
      call driven_section(square, rate, by_order, rates)
      call gauss_nodes(8, t, w)
      forces = 0.0_wp
      do k = 1, 8
        f = -2.0_wp + 10.0_wp*t(k)**3 + rate*(2.0_wp - 2.0_wp*t(k) + 2.5_wp*t(k)**4) &
            + square*(1.0_wp + 2.0_wp*t(k) - t(k)**2 + 0.5_wp*t(k)**5)
        forces = forces + w(k)*f*legendre(7, t(k))*[(2*order + 1, order=0, 7)]
      end do
      size_of = 2.5_wp + sum(abs(forces*by_order))
      call check_close(1.0_wp + by_q(1) + 2.0_wp*by_v(1) + sum(forces*by_order), 2.5_wp, &
                       1.0e-14_wp*size_of, 'displacement')
      ! A section displaced by 1 has velocities as large as its frequency.
      size_of = 2.5_wp + sqrt(abs(square)) + sum(abs(forces*rates))
      call check_close(2.0_wp + by_q(2) + 2.0_wp*by_v(2) + sum(forces*rates), 2.5_wp, &
                       1.0e-14_wp*size_of, 'velocity')
    end subroutine one

  end subroutine polynomial_motions

  !> v = 1 + 2 t - t^2 + t^5/2 is the response to v' + rate v; all digits of a number are correct.
  subroutine relaxing()
    real(wp) :: by_order(0:7), forces(0:7), t(8), w(8), gained, rate, v
    complex(wp) :: known(0:7)
    integer :: i, k, order

    call gauss_nodes(8, t, w)
    do i = 0, 160
      rate = 10.0_wp**(-8.0_wp + 0.1_wp*i)
      call relaxing_section(rate, gained, by_order)
      call legendre_moments(cmplx(-rate, 0.0_wp, wp), known)
      call check(all(abs(by_order - real(known)) <= 2.0e-15_wp*abs(by_order)), 'moments')
      forces = 0.0_wp
      do k = 1, 8
        v = 1.0_wp + 2.0_wp*t(k) - t(k)**2 + 0.5_wp*t(k)**5
        forces = forces + w(k)*(2.0_wp - 2.0_wp*t(k) + 2.5_wp*t(k)**4 + rate*v) &
                 *legendre(7, t(k))*[(2*order + 1, order=0, 7)]
      end do
      call check_close(1.0_wp + gained + sum(forces*by_order), 2.5_wp, &
                       1.0e-14_wp*(2.5_wp + sum(abs(forces*by_order))), 'velocity')
    end do
  end subroutine relaxing

  !> exp(i mu t) is the response to (square - mu^2 + i mu rate) exp(i mu t).
  subroutine waves()
    real(wp), parameter :: mus(7) = [0.0_wp, 1.0e-6_wp, 0.3_wp, 1.2_wp, 20.0_wp, 62.0_wp, 600.0_wp]
    real(wp) :: by_q(2), by_v(2), square, rate
    complex(wp) :: answer, velocity, d, wave
    integer :: i, j, k
    do i = 1, size(omegas)
      do j = 1, size(ratios)
        do k = 0, size(mus)
          square = omegas(i)**2
          rate = 2.0_wp*ratios(j)*omegas(i)
          ! Resonance is the first case.
          associate (mu => merge(omegas(i), mus(max(k, 1)), k == 0))
            call section_wave(square, rate, mu, answer, velocity)
            call free_section(square, rate, by_q, by_v)
            d = cmplx(square - mu**2, mu*rate, wp)
            wave = exp(cmplx(0.0_wp, mu, wp))
            call check(abs(d*answer + cmplx(1.0_wp + by_q(1), mu*by_v(1), wp) - wave) &
                       <= 1.0e-13_wp*(1.0_wp + abs(d*answer)), 'wave')
            call check(abs(d*velocity + cmplx(by_q(2), mu*(1.0_wp + by_v(2)), wp) &
                           - cmplx(0.0_wp, mu, wp)*wave) <= 1.0e-13_wp &
                       *(1.0_wp + mu + abs(by_q(2)) + abs(d*velocity)), 'its velocity')
            ! Small responses have full relative accuracy.
            if (omegas(i) < 1.0e-2_wp .and. mu < 1.0e-2_wp .and. ratios(j) < 2.0_wp) then
              call check_close(real(answer), 0.5_wp, 1.0e-2_wp, 'slow answer')
            end if
          end associate
        end do
      end do
    end do
  end subroutine waves

  subroutine halves()
    real(wp) :: by_q(2), by_v(2), half_q(2), half_v(2), q, v
    integer :: i, j
    do i = 1, size(omegas)
      do j = 1, size(ratios)
        call free_section(omegas(i)**2, 2.0_wp*ratios(j)*omegas(i), by_q, by_v)
        call free_section(0.25_wp*omegas(i)**2, ratios(j)*omegas(i), half_q, half_v)
        q = 1.0_wp + half_q(1) + 0.5_wp*half_v(1)*omegas(i)
        v = 2.0_wp*half_q(2) + (1.0_wp + half_v(2))*omegas(i)
        call check_close(q + half_q(1)*q + 0.5_wp*half_v(1)*v, &
                         1.0_wp + by_q(1) + by_v(1)*omegas(i), 1.0e-13_wp, 'displacement', 1.0_wp)
        call check_close(2.0_wp*half_q(2)*q + v + half_v(2)*v, &
                         by_q(2) + omegas(i)*(1.0_wp + by_v(2)), 1.0e-13_wp, 'velocity', &
                         1.0_wp + omegas(i))
      end do
    end do
  end subroutine halves

  !> Sums of Legendre polynomials that are powers: integral exp(z (1-x)) x^2 dx.
  subroutine moments()
    complex(wp) :: z, m(0:2), exact
    integer :: i
    do i = 1, 40
      z = 0.5_wp*i*cmplx(-0.4_wp, 1.0_wp, wp)
      call legendre_moments(z, m)
      ! x^2 = P_2/6 + P_1/2 + P_0/3.
      exact = 2.0_wp*(exp(z) - 1.0_wp - z - 0.5_wp*z**2)/z**3
      call check(abs(m(2)/6.0_wp + m(1)/2.0_wp + m(0)/3.0_wp - exact) < 3.0e-14_wp, 'x^2')
    end do
  end subroutine moments

end module test_structure_march
