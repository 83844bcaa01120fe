!> A sum of kernels, such as springs with different kernels in parallel, or a fit in several parts.
!!
!! All properties of a kernel are linear in it, so each part uses its own exact transforms, rules
!! and exponentials.
module viscovib_kernel_sum
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: kernel_sum, kernel_part

  type :: kernel_part
    class(kernel_type), allocatable :: kernel
  end type kernel_part

  type, extends(kernel_type) :: kernel_sum
    !> One or more kernels.
    type(kernel_part), allocatable :: parts(:)
  contains
    procedure :: transform
    procedure :: transform_slope
    procedure :: laplace
    procedure :: value
    procedure :: accumulated
    procedure :: integral
    procedure :: fading_rate
    procedure :: local_rules
    procedure :: lag_rule
    procedure :: exponentials
  end type kernel_sum

contains

  subroutine transform(self, mu, cosine, sine)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)
    real(wp), dimension(size(mu)) :: c, s
    integer :: p
    cosine = 0.0_wp
    sine = 0.0_wp
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%transform(mu, c, s)
      cosine = cosine + c
      sine = sine + s
    end do
  end subroutine transform

  !> Sum over the transforms of the parts.
  subroutine transform_slope(self, mu, transform, slope)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(in) :: transform(:)
    complex(wp), intent(out) :: slope(:)
    real(wp), dimension(size(mu)) :: c, s
    complex(wp), dimension(size(mu)) :: part
    integer :: p
    associate (whole => transform)
      slope = (0.0_wp, 0.0_wp)
    end associate
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%transform(mu, c, s)
      call self%parts(p)%kernel%transform_slope(mu, cmplx(c, -s, wp), part)
      slope = slope + part
    end do
  end subroutine transform_slope

  subroutine laplace(self, s, transform)
    class(kernel_sum), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp), intent(out) :: transform(:)
    complex(wp), dimension(size(s)) :: part
    integer :: p
    transform = (0.0_wp, 0.0_wp)
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%laplace(s, part)
      transform = transform + part
    end do
  end subroutine laplace

  subroutine value(self, t, r)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    real(wp), dimension(size(t)) :: part
    integer :: p
    r = 0.0_wp
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%value(t, part)
      r = r + part
    end do
  end subroutine value

  subroutine accumulated(self, t, r)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    real(wp), dimension(size(t)) :: part
    integer :: p
    r = 0.0_wp
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%accumulated(t, part)
      r = r + part
    end do
  end subroutine accumulated

  real(wp) function integral(self)
    class(kernel_sum), intent(in) :: self
    integer :: p
    integral = 0.0_wp
    do p = 1, size(self%parts)
      integral = integral + self%parts(p)%kernel%integral()
    end do
  end function integral

  !> Rate of the slowest part.
  pure real(wp) function fading_rate(self)
    class(kernel_sum), intent(in) :: self
    integer :: p
    fading_rate = huge(1.0_wp)
    do p = 1, size(self%parts)
      fading_rate = min(fading_rate, self%parts(p)%kernel%fading_rate())
    end do
  end function fading_rate

  subroutine local_rules(self, tau, nodes, weights)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: tau(:)
    real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    real(wp), allocatable :: x(:, :), w(:, :), longer(:, :)
    integer :: n, p

    allocate (nodes(0, size(tau)), weights(0, size(tau)))
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%local_rules(tau, x, w)
      n = size(nodes, 1)
      allocate (longer(n + size(x, 1), size(tau)))
      longer(:n, :) = nodes
      longer(n + 1:, :) = x
      call move_alloc(longer, nodes)
      allocate (longer(n + size(x, 1), size(tau)))
      longer(:n, :) = weights
      longer(n + 1:, :) = w
      call move_alloc(longer, weights)
    end do
  end subroutine local_rules

  subroutine lag_rule(self, from, to, nodes, weights)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp), allocatable, intent(out) :: nodes(:), weights(:)
    real(wp), allocatable :: x(:), w(:)
    integer :: p
    allocate (nodes(0), weights(0))
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%lag_rule(from, to, x, w)
      nodes = [nodes, x]
      weights = [weights, w]
    end do
  end subroutine lag_rule

  !> Positive sums keep the relative tolerance when added. Empty if a part has none.
  subroutine exponentials(self, tolerance, t_min, t_max, weights, rates)
    class(kernel_sum), intent(in) :: self
    real(wp), intent(in) :: tolerance, t_min, t_max
    real(wp), allocatable, intent(out) :: weights(:), rates(:)
    real(wp), allocatable :: w(:), r(:)
    integer :: p
    allocate (weights(0), rates(0))
    do p = 1, size(self%parts)
      call self%parts(p)%kernel%exponentials(tolerance, t_min, t_max, w, r)
      if (size(w) == 0) then
        weights = w
        rates = r
        return
      end if
      weights = [weights, w]
      rates = [rates, r]
    end do
  end subroutine exponentials

end module viscovib_kernel_sum
