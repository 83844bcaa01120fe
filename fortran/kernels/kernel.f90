!> Relaxation kernels: the abstract type that every kernel extends.
!!
!! A mount with memory replaces each stiffness c by c (1 - R*), where
!! (R*g)(t) = integral_0^t R(t-s) g(s) ds (seed paper 001, (5)). A kernel R
!! is known to the rest of the library by four things: its values, its
!! one-sided Fourier transform, its Laplace transform and its integral.
!! To add a kernel: extend this type in a file of its own and name it in
!! `catalogue.f90`.
module viscovib_kernel
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: kernel_type

  type, abstract :: kernel_type
  contains
    !> R_c(mu) = integral_0^inf R(t) cos(mu t) dt and R_s(mu) with the sine.
    procedure(transform_interface), deferred :: transform
    !> R(s) = integral_0^inf R(t) exp(-s t) dt, continued analytically.
    procedure(laplace_interface), deferred :: laplace
    !> R(t), t > 0.
    procedure(value_interface), deferred :: value
    !> integral_0^inf R(t) dt; +infinity where it does not exist.
    procedure(integral_interface), deferred :: integral
  end type kernel_type

  abstract interface

    !> Both transforms at once, since they share nearly all their work.
    !! R_c is even and R_s odd in mu.
    subroutine transform_interface(self, mu, cosine, sine)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
      !> Circular frequencies (rad/s). Not 0 for a kernel without integral.
      real(wp), intent(in) :: mu(:)
      !> R_c, R_s (dimensionless), same shape as mu.
      real(wp), intent(out) :: cosine(:), sine(:)
    end subroutine transform_interface

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
      !> R(t) (1/s), same shape as t.
      real(wp), intent(out) :: r(:)
    end subroutine value_interface

    real(wp) function integral_interface(self)
      import :: kernel_type, wp
      class(kernel_type), intent(in) :: self
    end function integral_interface

  end interface

end module viscovib_kernel
