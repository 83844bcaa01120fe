! Optimize: -O3
!> Polynomials of several variables up to the third degree, with arithmetic:
!! automatic differentiation up to the third order.
!!
!! p(x) = c0 + c1.x + c2(x,x) + c3(x,x,x) with symmetric c2 and c3, so that
!! c1, 2 c2 and 6 c3 are the derivatives at x = 0. Terms of a higher degree
!! are dropped (truncated Taylor arithmetic, Griewank and Walther, Evaluating
!! Derivatives, 2008, chapter 13).
module viscovib_jet
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: jet_type, variables, constant_jet, sine, cosine
  public :: operator(+), operator(-), operator(*)

  type :: jet_type
    real(wp) :: c0 = 0.0_wp
    !> Shapes (m), (m, m), (m, m, m).
    real(wp), allocatable :: c1(:), c2(:, :), c3(:, :, :)
  end type jet_type

  interface operator(+)
    module procedure add, add_number
  end interface operator(+)

  interface operator(-)
    module procedure subtract, subtract_number, negative
  end interface operator(-)

  interface operator(*)
    module procedure multiply, stretched
  end interface operator(*)

contains

  pure function constant_jet(value, m) result(p)
    real(wp), intent(in) :: value
    integer, intent(in) :: m
    type(jet_type) :: p
    p%c0 = value
    allocate (p%c1(m), p%c2(m, m), p%c3(m, m, m), source=0.0_wp)
  end function constant_jet

  !> The variables themselves, shape (m).
  pure function variables(m) result(x)
    integer, intent(in) :: m
    type(jet_type) :: x(m)
    integer :: i
    do i = 1, m
      x(i) = constant_jet(0.0_wp, m)
      x(i)%c1(i) = 1.0_wp
    end do
  end function variables

  pure function add(a, b) result(p)
    type(jet_type), intent(in) :: a, b
    type(jet_type) :: p
    p = a
    p%c0 = a%c0 + b%c0
    p%c1(:) = a%c1 + b%c1
    p%c2(:, :) = a%c2 + b%c2
    p%c3(:, :, :) = a%c3 + b%c3
  end function add

  pure function add_number(a, b) result(p)
    real(wp), intent(in) :: a
    type(jet_type), intent(in) :: b
    type(jet_type) :: p
    p = b
    p%c0 = a + b%c0
  end function add_number

  pure function subtract(a, b) result(p)
    type(jet_type), intent(in) :: a, b
    type(jet_type) :: p
    p = a + stretched(-1.0_wp, b)
  end function subtract

  pure function subtract_number(a, b) result(p)
    type(jet_type), intent(in) :: a
    real(wp), intent(in) :: b
    type(jet_type) :: p
    p = a
    p%c0 = a%c0 - b
  end function subtract_number

  pure function negative(a) result(p)
    type(jet_type), intent(in) :: a
    type(jet_type) :: p
    p = stretched(-1.0_wp, a)
  end function negative

  pure function stretched(factor, a) result(p)
    real(wp), intent(in) :: factor
    type(jet_type), intent(in) :: a
    type(jet_type) :: p
    p = a
    p%c0 = factor*a%c0
    p%c1(:) = factor*a%c1
    p%c2(:, :) = factor*a%c2
    p%c3(:, :, :) = factor*a%c3
  end function stretched

  pure function multiply(a, b) result(p)
    type(jet_type), intent(in) :: a, b
    type(jet_type) :: p
    integer :: i, j, k

    p = a%c0*b + b%c0*a
    p%c0 = a%c0*b%c0
    do j = 1, size(a%c1)
      do i = 1, size(a%c1)
        p%c2(i, j) = p%c2(i, j) + 0.5_wp*(a%c1(i)*b%c1(j) + a%c1(j)*b%c1(i))
      end do
    end do
    do k = 1, size(a%c1)
      do j = 1, size(a%c1)
        do i = 1, size(a%c1)
          p%c3(i, j, k) = p%c3(i, j, k) &
                          + (a%c1(i)*b%c2(j, k) + a%c1(j)*b%c2(i, k) + a%c1(k)*b%c2(i, j) &
                             + b%c1(i)*a%c2(j, k) + b%c1(j)*a%c2(i, k) + b%c1(k)*a%c2(i, j)) &
                          /3.0_wp
        end do
      end do
    end do
  end function multiply

  pure function sine(a) result(p)
    type(jet_type), intent(in) :: a
    type(jet_type) :: p
    p = composed(a, sin(a%c0), cos(a%c0), -sin(a%c0), -cos(a%c0))
  end function sine

  pure function cosine(a) result(p)
    type(jet_type), intent(in) :: a
    type(jet_type) :: p
    p = composed(a, cos(a%c0), -sin(a%c0), -cos(a%c0), sin(a%c0))
  end function cosine

  !> f(a) from the value of f and its three derivatives at a(0).
  pure function composed(a, f, d1, d2, d3) result(p)
    type(jet_type), intent(in) :: a
    real(wp), intent(in) :: f, d1, d2, d3
    type(jet_type) :: p, rest, square
    rest = a - a%c0
    square = rest*rest
    p = f + (d1*rest + ((0.5_wp*d2)*square + (d3/6.0_wp)*(square*rest)))
  end function composed

end module viscovib_jet
