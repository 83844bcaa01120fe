! Optimize: -O3
!> What Hill's determinant is multiplied by to become a polynomial: orders left out, divisors,
!! and what memory does to the stiffness at rest.
module viscovib_hill_orders
  use viscovib_band_elimination, only: band_determinant
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_kinds, only: wp
  use viscovib_polar, only: plain_logarithm
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: fading_rate, relaxation, tail, to_polynomial

contains

  !> Factor of the orders left out of the determinant, of 1 + (trace(M^(-1) C) - 2 a n)/s_k,
  !! summed over them by the midpoint rule.
  pure complex(wp) function tail(hill, lambda)
    class(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: lambda
    complex(wp) :: omega
    real(wp) :: edge, excess

    excess = hill%drag - 2.0_wp*hill%shift*hill%n_dof
    edge = (hill%highest + 0.5_wp*hill%stride)*hill%nu
    omega = cmplx(aimag(lambda), -real(lambda), wp)
    tail = exp(cmplx(0.0_wp, excess/hill%period, wp)*plain_logarithm((edge + omega)/(edge - omega)))
  end function tail

  !> Factor, without its constant, that makes D(lambda) the polynomial in z = exp(-2 pi lambda/d)
  !! which exp(-2 pi n lambda/d) times the product of all orders is without memory: it takes the
  !! divisors (s_k + a)^2n away and adds the orders left out, |k| > b, as
  !!
  !!   s_k^2n [1 + trace(M^(-1) C)/s_k + trace(M^(-1) K)/s_k^2],
  !!
  !! k and -k together, powers of 1/k summed by the midpoint rule and its first correction.
  pure complex(wp) function to_polynomial(hill, lambda) result(factor)
    class(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: lambda
    complex(wp) :: total, x
    real(wp) :: edge, step, by_2, by_4, by_6
    integer :: k

    total = (0.0_wp, 0.0_wp)
    do k = -hill%highest, hill%highest, hill%stride
      total = total + plain_logarithm((lambda + cmplx(hill%shift, k*hill%nu, wp)) &
                                      /abs(cmplx(hill%shift, k*hill%nu, wp)))
    end do
    step = hill%stride
    edge = hill%highest + 0.5_wp*step
    x = cmplx(aimag(lambda), -real(lambda), wp)/hill%nu
    by_2 = 1.0_wp/(step*edge) - step/(12.0_wp*edge**3)
    by_4 = 1.0_wp/(3.0_wp*step*edge**3) - step/(6.0_wp*edge**5)
    by_6 = 1.0_wp/(5.0_wp*step*edge**5)
    total = total - (x**2*by_2 + x**4/2.0_wp*by_4 + x**6/3.0_wp*by_6) - pi*lambda/hill%period
    factor = exp(2.0_wp*hill%n_dof*total - 6.0_wp*hill%trace*(x/hill%nu)**2*by_4 &
                 + cmplx(0.0_wp, 2.0_wp*hill%drag/hill%nu, wp) &
                 *x*(by_2 + x**2*by_4))
  end function to_polynomial

  !> What memory leaves of the static stiffness at rest at s = lambda (lambda - i d/2 under
  !! half-wave symmetry), det K(s)/det K without memory; 1 where that vanishes. Near s = 0 this is
  !! how slow memory enters D: with singularities at its rates, and zeros near them.
  complex(wp) function relaxation(hill, system, lambda) result(ratio)
    class(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    real(wp) :: re(hill%n_dof, hill%n_dof), im(hill%n_dof, hill%n_dof)
    complex(wp) :: kept(1), s(1), without
    integer :: a, j, q

    s(1) = lambda
    if (hill%stride == 2) s(1) = lambda - cmplx(0.0_wp, 0.5_wp*hill%period, wp)
    call eliminate_stiffness(.false., without)
    ratio = (1.0_wp, 0.0_wp)
    if (.not. abs(without) > 0.0_wp) return
    call eliminate_stiffness(.true., ratio)
    ratio = ratio/without

  contains

    subroutine eliminate_stiffness(remembers, value)
      logical, intent(in) :: remembers
      complex(wp), intent(out) :: value

      re = 0.0_wp
      im = 0.0_wp
      do j = 1, size(system%kernel_of)
        kept = (1.0_wp, 0.0_wp)
        q = system%kernel_of(j)
        if (remembers .and. q > 0) then
          call system%kernels(q)%laplace(s, kept)
          kept = 1.0_wp - kept
        end if
        do a = 1, hill%n_dof
          re(a, :) = re(a, :) + real(kept(1))*hill%spread(a, j)*system%gather(j, :)
          im(a, :) = im(a, :) + aimag(kept(1))*hill%spread(a, j)*system%gather(j, :)
        end do
      end do
      call band_determinant(hill%n_dof, hill%n_dof, hill%n_dof, re, im, value)
    end subroutine eliminate_stiffness

  end function relaxation

  !> The slowest rate at which a kernel in use fades (1/s): D has no singularity right of its
  !! negative.
  real(wp) function fading_rate(system) result(rate)
    class(oscillator_type), intent(in) :: system
    integer :: q

    rate = huge(1.0_wp)
    do q = 1, size(system%kernels)
      if (any(system%kernel_of == q)) rate = min(rate, system%kernels(q)%kernel%fading_rate())
    end do
  end function fading_rate

end module viscovib_hill_orders
