! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> A system up to third-degree terms, for the asymptotic methods:
!!
!!   (A_0 + A_1 d + A_2 d^2) y + (1 - R*) [H y + N_2(x, x) + N_3(x, x, x)] = load(t),
!!
!! d = d/dt, where each argument x_i is one of the unknowns y or one of their derivatives, and each
!! equation has its own relaxation kernel R, or none. The first unknowns are the coordinates of the
!! system; with memory the hereditary variables follow. Loads are columns times cos(p t).
module viscovib_polynomial_form
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: polynomial_form_type, term_type, full_system_type

  !> The term coefficient x_i x_j x_k in equation `row`; k = 0 in quadratic terms.
  type :: term_type
    integer :: row = 0, at(3) = 0
    real(wp) :: coefficient = 0.0_wp
  end type term_type

  !> The full system, which the form approximates to the third degree.
  type, abstract :: full_system_type
  contains
    procedure(sides_interface), deferred :: sides
  end type full_system_type

  abstract interface

    !> Left side minus load of each equation, at samples. With a kernel, only the operand of
    !! (1 - R*) is returned, without A_k.
    subroutine sides_interface(self, y, load, e)
      import :: full_system_type, wp
      class(full_system_type), intent(in) :: self
      !> Unknowns and their first two derivatives, shape (n_samples, n, 0:2).
      real(wp), intent(in), contiguous :: y(:, :, 0:)
      !> Unit loads cos(p_k t), shape (n_samples, n_loads).
      real(wp), intent(in), contiguous :: load(:, :)
      !> Shape (n_samples, n).
      real(wp), intent(out), contiguous :: e(:, :)
    end subroutine sides_interface

  end interface

  type :: polynomial_form_type
    !> Number of unknowns (and equations), of coordinates, and of arguments.
    integer :: n = 0, n_dof = 0, n_arguments = 0
    !> Argument i is derivative(i) of unknown source(i).
    integer, allocatable :: source(:), derivative(:)
    !> A_k, shape (n, n, 0:2), and H, shape (n, n).
    real(wp), allocatable :: linear(:, :, :), hereditary(:, :)
    type(term_type), allocatable :: quadratic(:), cubic(:)
    !> Kernel of each equation (0: none), and the kernels with their factors.
    integer, allocatable :: kernel_of(:)
    type(kernel_holder), allocatable :: kernels(:)
    !> Amplitudes, shape (n, n_loads), and circular frequencies of the loads.
    real(wp), allocatable :: load(:, :), drives(:)
    !> Approximate modes in columns: frequencies, mode shapes and left vectors of the system without
    !! damping and memory. They are initial values for the true modes.
    real(wp), allocatable :: omega(:), right(:, :), left(:, :)
    !> Not allocated: the form is exact.
    class(full_system_type), allocatable :: full
  contains
    procedure :: n_modes
    procedure :: copy_to
    procedure :: has_memory
    procedure :: retained
    procedure :: retained_between
    procedure :: operator_at
    procedure :: operator_between
    procedure :: second_difference
    procedure :: arguments_at
    procedure :: quadratic_at
    procedure :: cubic_at
  end type polynomial_form_type

contains

  pure integer function n_modes(self)
    class(polynomial_form_type), intent(in) :: self
    n_modes = size(self%omega)
  end function n_modes

  !> Copy all but the full system, component by component: gfortran 12 copies the array of kernels
  !! incorrectly.
  subroutine copy_to(self, copy)
    class(polynomial_form_type), intent(in) :: self
    !> Its arrays are kept if their shapes are the same.
    type(polynomial_form_type), intent(inout) :: copy
    copy%n = self%n
    copy%n_dof = self%n_dof
    copy%n_arguments = self%n_arguments
    copy%source = self%source
    copy%derivative = self%derivative
    if (.not. allocated(copy%linear)) allocate (copy%linear(self%n, self%n, 0:2))
    copy%linear(:, :, :) = self%linear
    copy%hereditary = self%hereditary
    copy%quadratic = self%quadratic
    copy%cubic = self%cubic
    copy%kernel_of = self%kernel_of
    call copy_kernels(self%kernels, copy%kernels)
    copy%load = self%load
    copy%drives = self%drives
    copy%omega = self%omega
    copy%right = self%right
    copy%left = self%left
  end subroutine copy_to

  pure logical function has_memory(self)
    class(polynomial_form_type), intent(in) :: self
    has_memory = any(self%kernel_of > 0)
  end function has_memory

  !> 1 - R(s) of each equation, R the Laplace transform. For decaying s with |Im s| <= |Re s| (the
  !! mean of a decaying solution) the history grows backward in time; the real part of s is then set
  !! to 0. A kernel with infinite integral relaxes completely under a constant load, up to rounding.
  function retained(self, s) result(fraction)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    complex(wp) :: fraction(self%n), transform(1), place
    integer :: i
    real(wp), parameter :: wholly = 1.0e12_wp
    place = s
    if (real(s) < 0.0_wp .and. abs(aimag(s)) <= abs(real(s))) place = cmplx(0.0_wp, aimag(s), wp)
    fraction = (1.0_wp, 0.0_wp)
    do i = 1, size(self%kernels)
      if (.not. any(self%kernel_of == i)) cycle
      if (abs(place) > 0.0_wp) then
        call self%kernels(i)%laplace([place], transform)
      else
        associate (holder => self%kernels(i))
          transform = cmplx(holder%factor*min(holder%kernel%integral(), wholly), 0.0_wp, wp)
        end associate
      end if
      where (self%kernel_of == i) fraction = 1.0_wp - transform(1)
    end do
  end function retained

  !> L(s) = A_0 + A_1 s + A_2 s^2 + (1 - R(s)) H.
  function operator_at(self, s) result(l)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    complex(wp) :: l(self%n, self%n)
    l = self%linear(:, :, 0) + s*(self%linear(:, :, 1) + s*self%linear(:, :, 2))
    if (self%has_memory()) then
      l = l + spread(self%retained(s), 2, self%n)*self%hereditary
    else
      l = l + self%hereditary
    end if
  end function operator_at

  !> Divided difference (L(s) - L(t))/(s - t), or the derivative if s = t: the action of L on an
  !! amplitude that varies with the detuning of a resonance.
  function operator_between(self, s, t) result(l)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s, t
    complex(wp) :: l(self%n, self%n)
    l = self%linear(:, :, 1) + (s + t)*self%linear(:, :, 2)
    if (.not. self%has_memory()) return
    l = l + spread(self%retained_between([s, t]), 2, self%n)*self%hereditary
  end function operator_between

  !> Second divided difference L[s, t, u].
  function second_difference(self, s, t, u) result(l)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s, t, u
    complex(wp) :: l(self%n, self%n)
    l = self%linear(:, :, 2)
    if (.not. self%has_memory()) return
    l = l + spread(self%retained_between([s, t, u]), 2, self%n)*self%hereditary
  end function second_difference

  !> Divided differences of 1 - R of each equation at two or three points. For close points it uses
  !! Cauchy's integral over a circle around them. The trapezoidal rule converges geometrically and
  !! needs no small divisors; only the radius amplifies rounding errors. The recursion (with nonzero
  !! points in place of zeros, or with fewer points) is at most two deep. The result is NaN for
  !! non-finite points, or for zero points without an oscillating mode.
  recursive function retained_between(self, s) result(slope)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp) :: slope(self%n)
    complex(wp) :: middle, ray(32), place(32), transform(32)
    real(wp) :: width, radius
    integer :: i, n, first, last
    real(wp), parameter :: two_pi = 6.283185307179586_wp

    slope = ieee_value(0.0_wp, ieee_quiet_nan)
    if (.not. all(abs(s) <= huge(1.0_wp))) return
    middle = sum(s)/size(s)
    if (.not. any(abs(s) > 0.0_wp)) then
      ! All points are 0: use small imaginary points on either side.
      middle = cmplx(0.0_wp, 1.0e-5_wp*minval(self%omega), wp)
      if (.not. (aimag(middle) > 0.0_wp .and. aimag(middle) <= huge(1.0_wp))) return
      slope = self%retained_between(s + middle*[(i - 0.5_wp*(size(s) + 1), i=1, size(s))])
      return
    end if
    width = maxval(abs(s - middle))/abs(middle)
    if (width > 0.1_wp) then
      call most_distant(s, first, last)
      slope = (without(last) - without(first))/(s(first) - s(last))
      return
    end if
    slope = (0.0_wp, 0.0_wp)
    ! Kernels are analytic off the negative real axis, whose distance is at least |middle| for an
    ! oscillating mode.
    n = merge(16, 32, width <= 0.005_wp)
    radius = merge(0.1_wp, 0.35_wp, width <= 0.005_wp)*abs(middle)
    ray(:n) = [(cmplx(cos(two_pi*i/n), sin(two_pi*i/n), wp)*radius, i=1, n)]
    place(:n) = middle + ray(:n)
    do i = 1, size(self%kernels)
      if (.not. any(self%kernel_of == i)) cycle
      call self%kernels(i)%laplace(place(:n), transform(:n))
      transform(:n) = transform(:n)*ray(:n)
      do first = 1, size(s)
        transform(:n) = transform(:n)/(place(:n) - s(first))
      end do
      where (self%kernel_of == i) slope = -sum(transform(:n))/n
    end do

  contains

    !> The divided difference without point k.
    function without(k) result(value)
      integer, intent(in) :: k
      complex(wp) :: value(self%n)
      integer :: j
      if (size(s) == 2) then
        value = self%retained(s(3 - k))
      else
        value = self%retained_between(pack(s, [(j /= k, j=1, size(s))]))
      end if
    end function without

  end function retained_between

  !> The two points farthest apart.
  pure subroutine most_distant(s, first, last)
    complex(wp), intent(in) :: s(:)
    integer, intent(out) :: first, last
    integer :: i, j
    first = 1
    last = 2
    do j = 2, size(s)
      do i = 1, j - 1
        if (abs(s(i) - s(j)) <= abs(s(first) - s(last))) cycle
        first = i
        last = j
      end do
    end do
  end subroutine most_distant

  !> Arguments x of the solution y exp(s t).
  pure function arguments_at(self, s, y) result(x)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s, y(:)
    complex(wp) :: x(self%n_arguments), powers(0:2)
    integer :: i
    powers = [(1.0_wp, 0.0_wp), s, s*s]
    do i = 1, self%n_arguments
      x(i) = y(self%source(i))*powers(self%derivative(i))
    end do
  end function arguments_at

  !> The symmetric bilinear form N_2(a, b), without kernels.
  pure function quadratic_at(self, a, b) result(value)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: a(:), b(:)
    complex(wp) :: value(self%n)
    integer :: i
    value = (0.0_wp, 0.0_wp)
    do i = 1, size(self%quadratic)
      associate (t => self%quadratic(i))
        value(t%row) = value(t%row) + 0.5_wp*t%coefficient &
                       *(a(t%at(1))*b(t%at(2)) + a(t%at(2))*b(t%at(1)))
      end associate
    end do
  end function quadratic_at

  !> The symmetric trilinear form N_3(a, b, c), without kernels.
  pure function cubic_at(self, a, b, c) result(value)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: a(:), b(:), c(:)
    complex(wp) :: value(self%n)
    integer :: n
    value = (0.0_wp, 0.0_wp)
    do n = 1, size(self%cubic)
      associate (t => self%cubic(n), i => self%cubic(n)%at(1), j => self%cubic(n)%at(2), &
                 k => self%cubic(n)%at(3))
        value(t%row) = value(t%row) + (t%coefficient/6.0_wp) &
                       *(a(i)*(b(j)*c(k) + b(k)*c(j)) + a(j)*(b(i)*c(k) + b(k)*c(i)) &
                         + a(k)*(b(i)*c(j) + b(j)*c(i)))
      end associate
    end do
  end function cubic_at

end module viscovib_polynomial_form
