! Optimize: -O2
!> Hill's determinant along a line Re lambda = -delta, and what it says of the exponents.
!!
!! Nodes lie on the line from its start to i d/2; delta is 0, or left of exponents that are to be
!! counted too, but right of all singularities. Where a kernel has no integral, a quarter of a small
!! circle goes round its branch point. At first they are evenly spaced. Without memory
!! D(lambda) times a known factor is a polynomial of degree 2n in z = exp(-2 pi lambda/d) with
!! real coefficients, and what is remembered over m periods adds to its coefficient m. Most of
!! that is what memory leaves of the static stiffness, which is divided out. 2n + 4 values
!! around a circle, of which half mirror the others, give the polynomial, and its zeros
!! are near those of D.
module viscovib_hill_path
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_hill_orders, only: relaxation, tail, to_polynomial
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_zeros, only: polynomial_zeros
  implicit none
  private

  public :: hill_path_type, new_hill_path

  !> Nodes at most, and as a rule of those a motion needs.
  integer, parameter :: max_nodes = 1200, usual_nodes = 64
  !> Around the branch point of a kernel without integral: a radius in d, and pieces.
  real(wp), parameter :: radius = 1.0e-12_wp
  integer, parameter :: n_arc = 8

  type :: hill_path_type
    !> delta (rad/s).
    real(wp) :: shift = 0.0_wp
    integer :: n = 0
    !> Nodes in order, and D there with the factor of the orders left out.
    complex(wp), allocatable :: lambda(:), value(:)
    !> What memory leaves of the static stiffness there.
    complex(wp), allocatable :: ratio(:)
    !> Not D but that ratio is meant by `value`.
    logical, private :: of_ratio = .false.
    !> The evenly spaced ones, and D there over what memory leaves of the static stiffness.
    complex(wp), allocatable, private :: even(:), even_value(:)
  contains
    procedure :: path_of_ratio
    procedure :: split
    procedure :: approximations
  end type hill_path_type

contains

  subroutine new_hill_path(path, hill, system, shift)
    type(hill_path_type), intent(out) :: path
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> delta, less than the rate at which memory fades; 0 unless given.
    real(wp), intent(in), optional :: shift
    complex(wp) :: centre, lambda
    real(wp) :: low, high, angle
    integer :: i, pieces
    logical :: singular

    if (present(shift)) path%shift = shift
    allocate (path%lambda(usual_nodes), path%value(usual_nodes), path%ratio(usual_nodes))
    if (.not. hill%ready) return
    low = 0.0_wp
    high = 0.5_wp*hill%period
    singular = system%kernel_without_integral() /= 0
    if (singular .and. hill%stride == 1) low = radius*hill%period
    if (singular .and. hill%stride == 2) high = high - radius*hill%period
    if (singular .and. hill%stride == 1) call arc((0.0_wp, 0.0_wp), 0.0_wp, 0, n_arc - 1)
    pieces = hill%n_dof + 2
    allocate (path%even(0:pieces), path%even_value(0:pieces))
    do i = 0, pieces
      lambda = cmplx(-path%shift, low + (high - low)*i/pieces, wp)
      call append(lambda)
      path%even(i) = lambda
      path%even_value(i) = path%value(path%n)/path%ratio(path%n)
    end do
    if (.not. singular .or. hill%stride == 1) return
    centre = cmplx(0.0_wp, 0.5_wp*hill%period, wp)
    call arc(centre, -0.5_wp*pi, 1, n_arc)

  contains

    subroutine arc(about, from, first, last)
      complex(wp), intent(in) :: about
      real(wp), intent(in) :: from
      integer, intent(in) :: first, last
      integer :: k
      do k = first, last
        angle = from + 0.5_wp*pi*k/n_arc
        call append(about + radius*hill%period*cmplx(cos(angle), sin(angle), wp))
      end do
    end subroutine arc

    subroutine append(node)
      complex(wp), intent(in) :: node
      path%n = path%n + 1
      path%lambda(path%n) = node
      call evaluate(path, hill, system, node, path%value(path%n), path%ratio(path%n))
    end subroutine append

  end subroutine new_hill_path

  subroutine evaluate(path, hill, system, lambda, value, ratio)
    class(hill_path_type), intent(in) :: path
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value, ratio

    ratio = relaxation(hill, system, lambda)
    value = ratio
    if (path%of_ratio) return
    call hill%determinant(system, lambda, value)
    value = value*tail(hill, lambda)
  end subroutine evaluate

  !> The same nodes with what memory leaves of the static stiffness instead of D.
  subroutine path_of_ratio(self, path)
    class(hill_path_type), intent(in) :: self
    type(hill_path_type), intent(out) :: path

    path%shift = self%shift
    path%n = self%n
    allocate (path%lambda, source=self%lambda)
    allocate (path%value, path%ratio, source=self%ratio)
    path%of_ratio = .true.
  end subroutine path_of_ratio

  !> Nodes amid the intervals that are marked.
  subroutine split(self, hill, system, marked, made)
    class(hill_path_type), intent(inout) :: self
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Shape (n - 1).
    logical, intent(in) :: marked(:)
    !> Not where there would be too many, or where numbers do not lie closer.
    logical, intent(out) :: made
    complex(wp), allocatable :: lambda(:), value(:), ratio(:)
    complex(wp) :: middle
    integer :: i, k, n

    n = self%n + count(marked)
    made = n <= max_nodes
    if (.not. made) return
    allocate (lambda(max(n, size(self%lambda))), value(max(n, size(self%lambda))), &
              ratio(max(n, size(self%lambda))))
    k = 0
    do i = 1, self%n
      k = k + 1
      lambda(k) = self%lambda(i)
      value(k) = self%value(i)
      ratio(k) = self%ratio(i)
      if (i == self%n) exit
      if (.not. marked(i)) cycle
      middle = 0.5_wp*(self%lambda(i) + self%lambda(i + 1))
      made = made .and. abs(middle - self%lambda(i)) > epsilon(1.0_wp)*hill%period
      k = k + 1
      lambda(k) = middle
      call evaluate(self, hill, system, middle, value(k), ratio(k))
    end do
    self%n = n
    call move_alloc(lambda, self%lambda)
    call move_alloc(value, self%value)
    call move_alloc(ratio, self%ratio)
  end subroutine split

  !> Zeros of the polynomial, both of conjugate pairs: exponents without memory but for the
  !! orders left out, near exponents with it. None where they are not found.
  subroutine approximations(self, hill, exponents)
    class(hill_path_type), intent(in) :: self
    type(hill_type), intent(in) :: hill
    complex(wp), allocatable, intent(out) :: exponents(:)
    real(wp) :: c(0:2*hill%n_dof), angle
    complex(wp) :: multipliers(2*hill%n_dof), at_node(0:hill%n_dof + 2)
    integer :: j, m, half
    logical :: found

    allocate (exponents(0))
    if (.not. allocated(self%even)) return
    half = ubound(self%even, 1)
    do j = 0, half
      at_node(j) = self%even_value(j)/tail(hill, self%even(j))*to_polynomial(hill, self%even(j))
    end do
    if (.not. all(abs(at_node) <= sqrt(huge(1.0_wp)))) return
    do m = 0, 2*hill%n_dof
      c(m) = real(at_node(0)) + (1 - 2*modulo(m, 2))*real(at_node(half))
      do j = 1, half - 1
        angle = pi*modulo(m*j, 2*half)/half
        c(m) = c(m) + 2.0_wp*real(at_node(j)*cmplx(cos(angle), sin(angle), wp))
      end do
    end do
    if (.not. abs(c(0)) > 1.0e-10_wp*maxval(abs(c))) return
    ! Of 1/z, the multipliers, times the radius of the circle.
    call polynomial_zeros(c, multipliers, found)
    if (.not. found) return
    multipliers = pack(multipliers, abs(multipliers) > tiny(1.0_wp), &
                       [(cmplx(tiny(1.0_wp), 0.0_wp, wp), j=1, size(multipliers))])
    exponents = hill%period/(2.0_wp*pi)*log(multipliers) - self%shift
  end subroutine approximations

end module viscovib_hill_path
