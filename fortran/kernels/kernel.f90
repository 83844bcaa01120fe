! Optimize: -O2
!> Relaxation kernels: the abstract type that every kernel extends.
!!
!! A mount with memory replaces each stiffness c by c (1 - R*), where
!! (R*g)(t) = integral_0^t R(t-s) g(s) ds (seed paper 001, (5)). A kernel R is defined by its
!! values, its one-sided Fourier transform, its Laplace transform and its integral. Integration in
!! time also uses quadrature rules for R times a polynomial and a sum of exponentials. To add a
!! kernel: extend this type in a file of its own and name it in `catalogue.f90`.
module viscovib_kernel
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: kernel_type, shrinking

  type, abstract :: kernel_type
    !> Time up to which R is smooth from t = 0 on, if it is not smooth later; otherwise 0.
    real(wp) :: smooth_until = 0.0_wp
  contains
    !> R_c(mu) = integral_0^inf R(t) cos(mu t) dt and R_s(mu) with the sine.
    procedure(transform_interface), deferred :: transform
    !> dRhat/dmu, Rhat = R_c - i R_s.
    procedure(slope_interface), deferred :: transform_slope
    !> R(s) = integral_0^inf R(t) exp(-s t) dt, continued analytically.
    procedure(laplace_interface), deferred :: laplace
    !> R(t), t > 0.
    procedure(value_interface), deferred :: value
    !> integral_0^t R(s) ds, t > 0.
    procedure(value_interface), deferred :: accumulated
    !> integral_0^inf R(t) dt; +infinity where it does not exist.
    procedure(integral_interface), deferred :: integral
    !> Largest rate r >= 0 (1/s) such that R(s) is analytic right of -r.
    procedure(fading_rate_interface), deferred :: fading_rate
    !> Quadrature for R times a polynomial over [0, tau], including the singularity.
    procedure(local_interface), deferred :: local_rules
    !> The same over [from, to], from > 0.
    procedure :: lag_rule
    procedure :: is_zero
    !> R(t) as a sum of exponentials between two times.
    procedure(exponentials_interface), deferred :: exponentials
  end type kernel_type

  !> Number of nodes of a panel over which the kernel at most halves its argument, and of a panel
  !! over which an exponential may vanish.
  integer, parameter, public :: panel_nodes = 16, decay_nodes = 32
  !> exp(-vanished) is negligible compared with 1.
  real(wp), parameter, public :: vanished = 45.0_wp

  abstract interface

    !> Both transforms together, since they share most of the computation. R_c is even and R_s odd
    !! in mu.
    subroutine transform_interface(self, mu, cosine, sine)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      !> Circular frequencies (rad/s). Not 0 for a kernel without integral.
      real(wp), intent(in) :: mu(:)
      !> R_c, R_s (dimensionless), same shape as mu.
      real(wp), intent(out) :: cosine(:), sine(:)
    end subroutine transform_interface

    subroutine slope_interface(self, mu, transform, slope)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      !> Circular frequencies (rad/s), not 0.
      real(wp), intent(in) :: mu(:)
      !> R_c - i R_s there, same shape.
      complex(wp), intent(in) :: transform(:)
      !> Derivative by mu (s), same shape.
      complex(wp), intent(out) :: slope(:)
    end subroutine slope_interface

    subroutine laplace_interface(self, s, transform)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      !> Points of the complex plane (1/s), off the branch cut.
      complex(wp), intent(in) :: s(:)
      !> Laplace transform (dimensionless), same shape as s.
      complex(wp), intent(out) :: transform(:)
    end subroutine laplace_interface

    subroutine value_interface(self, t, r)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      !> Times (s), all > 0.
      real(wp), intent(in) :: t(:)
      !> R(t) (1/s), or its integral up to t, same shape as t.
      real(wp), intent(out) :: r(:)
    end subroutine value_interface

    real(wp) function integral_interface(self)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
    end function integral_interface

    pure real(wp) function fading_rate_interface(self)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
    end function fading_rate_interface

    !> integral_0^tau R(t) g(t) dt = sum_k weights(k) g(nodes(k)) to rounding for
    !! polynomials g up to degree 12, for each tau.
    subroutine local_interface(self, tau, nodes, weights)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      !> Shape (m), all > 0.
      real(wp), intent(in) :: tau(:)
      !> A column for each tau.
      real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    end subroutine local_interface

    !> R(t) = sum_q weights(q) exp(-rates(q) t) on [t_min, t_max] within the relative `tolerance`,
    !! weights > 0. Empty if this kernel has no such sum.
    subroutine exponentials_interface(self, tolerance, t_min, t_max, weights, rates)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      real(wp), intent(in) :: tolerance, t_min, t_max
      real(wp), allocatable, intent(out) :: weights(:), rates(:)
    end subroutine exponentials_interface

  end interface

contains

  !> integral_from^to R(t) g(t) dt = sum_k weights(k) g(nodes(k)), by Gauss panels whose distance
  !! from the singularity doubles.
  subroutine lag_rule(self, from, to, nodes, weights)
    class(kernel_type), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp), allocatable, intent(out) :: nodes(:), weights(:)
    real(wp) :: left, right
    integer :: n, k

    n = max(1, ceiling(log(to/from)/log(2.0_wp)*(1.0_wp - 1.0e-12_wp)))
    allocate (nodes(n*panel_nodes), weights(n*panel_nodes))
    right = from
    do k = 1, n
      left = right
      right = from*(to/from)**(real(k, wp)/n)
      associate (here => nodes((k - 1)*panel_nodes + 1:k*panel_nodes), &
                 part => weights((k - 1)*panel_nodes + 1:k*panel_nodes))
        here = left + (right - left)*points_16
        call self%value(here, part)
        part = (right - left)*weights_16*part
      end associate
    end do
  end subroutine lag_rule

  !> 1 - exp(-x) without cancellation for small x.
  elemental real(wp) function shrinking(x)
    real(wp), intent(in) :: x
    integer :: n
    if (abs(x) > 0.5_wp) then
      shrinking = 1.0_wp - exp(-x)
    else
      shrinking = 1.0_wp
      do n = 14, 2, -1
        shrinking = 1.0_wp - shrinking*x/n
      end do
      shrinking = shrinking*x
    end if
  end function shrinking

  !> True if R = 0: no memory.
  logical function is_zero(self)
    class(kernel_type), intent(in) :: self
    real(wp) :: value(1), cosine(1), sine(1)

    is_zero = .false.
    if (abs(self%integral()) > 0.0_wp) return
    call self%value([1.0_wp], value)
    call self%transform([1.0_wp], cosine, sine)
    is_zero = .not. any(abs([value, cosine, sine]) > 0.0_wp)
  end function is_zero

end module viscovib_kernel
