!> A system up to its third-degree terms, as the asymptotic methods take it:
!!
!!   (A_0 + A_1 d + A_2 d^2) y + (1 - R*) [H y + N_2(x, x) + N_3(x, x, x)] = load(t),
!!
!! d = d/dt, where each argument x_i is one of the unknowns y or one of their
!! derivatives, and each equation has its own relaxation kernel R, or none. The
!! first unknowns are the coordinates of the system; with memory the hereditary
!! variables follow. Loads are columns times cos(p t).
module viscovib_polynomial_form
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: kernel_holder
  implicit none
  private

  public :: polynomial_form_type, term_type

  !> coefficient x_i x_j x_k in equation `row`; k = 0 in quadratic terms.
  type :: term_type
    integer :: row = 0, at(3) = 0
    real(wp) :: coefficient = 0.0_wp
  end type term_type

  type :: polynomial_form_type
    !> Unknowns (as many as equations), coordinates among them, arguments.
    integer :: n = 0, n_dof = 0, n_arguments = 0
    !> Argument i is derivative(i) of unknown source(i).
    integer, allocatable :: source(:), derivative(:)
    !> A_k, shape (n, n, 0:2), and H, shape (n, n).
    real(wp), allocatable :: linear(:, :, :), hereditary(:, :)
    type(term_type), allocatable :: quadratic(:), cubic(:)
    !> Kernel of each equation (0: none), and the factor of all kernels.
    integer, allocatable :: kernel_of(:)
    type(kernel_holder), allocatable :: kernels(:)
    real(wp) :: memory_scale = 1.0_wp
    !> Amplitudes, shape (n, n_loads), and circular frequencies of the loads.
    real(wp), allocatable :: load(:, :), drives(:)
    !> Near the modes: frequencies, shapes and left vectors, a column each, of the
    !! system without damping and memory. Search for the true ones begins here.
    real(wp), allocatable :: omega(:), right(:, :), left(:, :)
  contains
    procedure :: n_modes
    procedure :: has_memory
    procedure :: retained
    procedure :: operator_at
    procedure :: operator_between
    procedure :: arguments_at
    procedure :: quadratic_at
    procedure :: cubic_at
  end type polynomial_form_type

contains

  pure integer function n_modes(self)
    class(polynomial_form_type), intent(in) :: self
    n_modes = size(self%omega)
  end function n_modes

  pure logical function has_memory(self)
    class(polynomial_form_type), intent(in) :: self
    has_memory = any(self%kernel_of > 0)
  end function has_memory

  !> 1 - R(s) of each equation, R the Laplace transform.
  function retained(self, s) result(fraction)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    complex(wp) :: fraction(self%n), transform(1)
    integer :: i
    fraction = (1.0_wp, 0.0_wp)
    do i = 1, size(self%kernels)
      if (.not. any(self%kernel_of == i)) cycle
      call self%kernels(i)%kernel%laplace([s], transform)
      where (self%kernel_of == i) fraction = 1.0_wp - self%memory_scale*transform(1)
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

  !> Divided difference (L(s) - L(t))/(s - t), the derivative where s = t: what
  !! L does to an amplitude that changes at the rate of a resonance.
  function operator_between(self, s, t) result(l)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s, t
    complex(wp) :: l(self%n, self%n), slope(self%n), middle, h
    l = self%linear(:, :, 1) + (s + t)*self%linear(:, :, 2)
    if (.not. self%has_memory()) return
    if (abs(s - t) > 1.0e-5_wp*abs(s)) then
      slope = (self%retained(s) - self%retained(t))/(s - t)
    else
      ! Four points around: the error is of the fourth order in h.
      middle = 0.5_wp*(s + t)
      h = 1.0e-3_wp*abs(middle)
      slope = (self%retained(middle + h) - self%retained(middle - h) &
               - (0.0_wp, 1.0_wp)*(self%retained(middle + (0.0_wp, 1.0_wp)*h) &
                                   - self%retained(middle - (0.0_wp, 1.0_wp)*h)))/(4.0_wp*h)
    end if
    l = l + spread(slope, 2, self%n)*self%hereditary
  end function operator_between

  !> x of the motion y exp(s t).
  pure function arguments_at(self, s, y) result(x)
    class(polynomial_form_type), intent(in) :: self
    complex(wp), intent(in) :: s, y(:)
    complex(wp) :: x(self%n_arguments)
    integer :: i
    do i = 1, self%n_arguments
      x(i) = y(self%source(i))*s**self%derivative(i)
    end do
  end function arguments_at

  !> The symmetric bilinear N_2(a, b), kernels left out.
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

  !> The symmetric trilinear N_3(a, b, c), kernels left out.
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
