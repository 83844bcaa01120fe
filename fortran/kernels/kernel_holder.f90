! Optimize: -O2
!> A kernel with its factor, as an array element.
!!
!! Systems use the kernel epsilon_1 R (seed paper 001, (5)): R is the kernel and epsilon_1 the
!! factor. All results of the holder include the factor.
module viscovib_kernel_holder
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: kernel_holder, copy_kernels

  type :: kernel_holder
    class(kernel_type), allocatable :: kernel
    !> epsilon_1.
    real(wp) :: factor = 1.0_wp
  contains
    !> Same as the procedures of `kernel_type`, times the factor.
    procedure :: transform
    procedure :: transform_slope
    procedure :: laplace
    procedure :: value
    procedure :: integral
    procedure :: local_rules
    procedure :: lag_rule
    procedure :: exponentials
    procedure :: is_zero
  end type kernel_holder

contains

  !> Deep copy, element by element: with intrinsic assignment of the whole array, gfortran 12 shares
  !! the polymorphic components and frees them twice.
  subroutine copy_kernels(from, to)
    type(kernel_holder), intent(in) :: from(:)
    type(kernel_holder), allocatable, intent(out) :: to(:)
    integer :: i
    allocate (to(size(from)))
    do i = 1, size(from)
      allocate (to(i)%kernel, source=from(i)%kernel)
      to(i)%factor = from(i)%factor
    end do
  end subroutine copy_kernels

  subroutine transform(self, mu, cosine, sine)
    class(kernel_holder), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)
    call self%kernel%transform(mu, cosine, sine)
    cosine = self%factor*cosine
    sine = self%factor*sine
  end subroutine transform

  subroutine transform_slope(self, mu, transform, slope)
    class(kernel_holder), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    !> Including the factor, as `transform` returns it.
    complex(wp), intent(in) :: transform(:)
    complex(wp), intent(out) :: slope(:)
    slope = (0.0_wp, 0.0_wp)
    if (.not. abs(self%factor) > 0.0_wp) return
    call self%kernel%transform_slope(mu, transform/self%factor, slope)
    slope = self%factor*slope
  end subroutine transform_slope

  subroutine laplace(self, s, transform)
    class(kernel_holder), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp), intent(out) :: transform(:)
    call self%kernel%laplace(s, transform)
    transform = self%factor*transform
  end subroutine laplace

  subroutine value(self, t, r)
    class(kernel_holder), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    call self%kernel%value(t, r)
    r = self%factor*r
  end subroutine value

  !> 0 for a zero factor, even if the kernel has no integral.
  real(wp) function integral(self)
    class(kernel_holder), intent(in) :: self
    integral = 0.0_wp
    if (abs(self%factor) > 0.0_wp) integral = self%factor*self%kernel%integral()
  end function integral

  subroutine local_rules(self, tau, nodes, weights)
    class(kernel_holder), intent(in) :: self
    real(wp), intent(in) :: tau(:)
    real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    call self%kernel%local_rules(tau, nodes, weights)
    weights = self%factor*weights
  end subroutine local_rules

  subroutine lag_rule(self, from, to, nodes, weights)
    class(kernel_holder), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp), allocatable, intent(out) :: nodes(:), weights(:)
    call self%kernel%lag_rule(from, to, nodes, weights)
    weights = self%factor*weights
  end subroutine lag_rule

  subroutine exponentials(self, tolerance, t_min, t_max, weights, rates)
    class(kernel_holder), intent(in) :: self
    real(wp), intent(in) :: tolerance, t_min, t_max
    real(wp), allocatable, intent(out) :: weights(:), rates(:)
    call self%kernel%exponentials(tolerance, t_min, t_max, weights, rates)
    weights = self%factor*weights
  end subroutine exponentials

  logical function is_zero(self)
    class(kernel_holder), intent(in) :: self
    is_zero = .true.
    if (abs(self%factor) > 0.0_wp) is_zero = self%kernel%is_zero()
  end function is_zero

end module viscovib_kernel_holder
