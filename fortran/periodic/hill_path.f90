! Optimize: -O3
!> Hill's determinant along a line Re lambda = sigma, and approximations of the exponents from it.
!!
!! Nodes lie on the line from its start to i d/2; sigma is near 0, or left of exponents that are to
!! be counted too, but right of all singularities. At first nodes are evenly spaced, and more of
!! them lead to the end of the line where memory has its singularities. Without memory the
!! determinant is a polynomial of degree 2n in z = exp(-2 pi lambda/d) with real coefficients, and
!! what is remembered over m periods adds to its coefficient m. Most of that is what memory leaves
!! of the static stiffness, which is divided out. 2n + 4 values around a circle, of which half
!! mirror the others, give the polynomial, and its zeros are near those of the determinant.
module viscovib_hill_path
  use viscovib_constants, only: pi
  use viscovib_hill_determinant, only: hill_determinant, slow
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_zeros, only: polynomial_zeros
  implicit none
  private

  public :: hill_path_type, new_hill_path

  !> Nodes at most.
  integer, parameter :: max_nodes = 1200

  type :: hill_path_type
    !> sigma (1/s).
    real(wp) :: line = 0.0_wp
    integer :: n = 0
    !> Nodes in order, and the determinant there.
    complex(wp), allocatable :: lambda(:), value(:)
    !> What memory leaves of the static stiffness there.
    complex(wp), allocatable :: ratio(:)
    !> Not the determinant but that ratio is meant by `value`.
    logical, private :: of_ratio = .false.
    !> Pieces at first.
    integer, private :: pieces = 1
  contains
    procedure :: path_of_ratio
    procedure :: split
    procedure :: approximations
    procedure, private :: evaluate
  end type hill_path_type

contains

  subroutine new_hill_path(path, hill, system, line, pieces)
    type(hill_path_type), intent(out) :: path
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    !> sigma (1/s), right of the rate at which memory fades; 0 passes right of a branch point there.
    real(wp), intent(in) :: line
    integer, intent(in) :: pieces
    real(wp), allocatable :: y(:)
    real(wp) :: width
    integer :: i

    path%line = line
    if (hill%creeps .and. .not. line < 0.0_wp) path%line = slow*hill%period
    path%pieces = pieces
    if (.not. hill%ready) return
    allocate (y, source=[(0.5_wp*hill%period*i/pieces, i=0, pieces)])
    width = y(2)
    do while (width > max(hill%finest + path%line, slow*hill%period))
      width = 0.5_wp*width
      if (hill%stride == 2) then
        y = [y(:size(y) - 1), 0.5_wp*hill%period - width, y(size(y))]
      else
        y = [y(1), width, y(2:)]
      end if
    end do
    path%n = size(y)
    allocate (path%lambda(path%n), path%value(path%n), path%ratio(path%n))
    path%lambda = cmplx(path%line, y, wp)
    do i = 1, path%n
      call path%evaluate(hill, system, i)
    end do
  end subroutine new_hill_path

  subroutine evaluate(self, hill, system, i)
    class(hill_path_type), intent(inout) :: self
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: i

    self%ratio(i) = hill%relaxation(system, self%lambda(i))
    self%value(i) = self%ratio(i)
    if (.not. self%of_ratio) call hill%on_line(system, self%lambda(i), self%value(i))
  end subroutine evaluate

  !> The same nodes with what memory leaves of the static stiffness instead of the determinant.
  subroutine path_of_ratio(self, path)
    class(hill_path_type), intent(in) :: self
    type(hill_path_type), intent(out) :: path

    path%line = self%line
    path%n = self%n
    allocate (path%lambda, source=self%lambda)
    allocate (path%value, path%ratio, source=self%ratio)
    path%of_ratio = .true.
  end subroutine path_of_ratio

  !> Nodes amid the intervals that are marked.
  subroutine split(self, hill, system, marked, made)
    class(hill_path_type), intent(inout) :: self
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    !> Shape (n - 1).
    logical, intent(in) :: marked(:)
    !> Not where there would be too many, or where numbers do not lie closer.
    logical, intent(out) :: made
    complex(wp), dimension(self%n + count(marked)) :: lambda, value, ratio
    logical :: old(size(lambda))
    integer :: i, k

    made = size(lambda) <= max_nodes
    if (.not. made) return
    k = 0
    old = .true.
    do i = 1, self%n
      k = k + 1
      lambda(k) = self%lambda(i)
      value(k) = self%value(i)
      ratio(k) = self%ratio(i)
      if (i == self%n) exit
      if (.not. marked(i)) cycle
      k = k + 1
      lambda(k) = 0.5_wp*(self%lambda(i) + self%lambda(i + 1))
      made = made .and. abs(lambda(k) - self%lambda(i)) > epsilon(1.0_wp)*hill%period
      old(k) = .false.
    end do
    self%n = k
    self%lambda = lambda
    self%value = value
    self%ratio = ratio
    do k = 1, self%n
      if (.not. old(k)) call self%evaluate(hill, system, k)
    end do
  end subroutine split

  !> Zeros of the polynomial, both of conjugate pairs: exponents without memory but for the
  !! orders left out, near exponents with it. None where they are not found, or where the path began
  !! with too few pieces.
  subroutine approximations(self, hill, exponents)
    class(hill_path_type), intent(in) :: self
    class(hill_determinant), intent(in) :: hill
    complex(wp), allocatable, intent(out) :: exponents(:)
    real(wp) :: c(0:hill%n_without_memory), angle
    complex(wp) :: multipliers(hill%n_without_memory), at_node(0:self%pieces)
    integer :: j, k, m
    logical :: found

    allocate (exponents(0))
    if (self%n == 0 .or. 2*self%pieces < hill%n_without_memory + 2) return
    do j = 0, self%pieces
      k = minloc(abs(aimag(self%lambda(:self%n)) - 0.5_wp*hill%period*j/self%pieces), 1)
      at_node(j) = self%value(k)/self%ratio(k)
    end do
    if (.not. all(abs(at_node) <= sqrt(huge(1.0_wp)))) return
    do m = 0, ubound(c, 1)
      c(m) = real(at_node(0)) + (1 - 2*modulo(m, 2))*real(at_node(self%pieces))
      do j = 1, self%pieces - 1
        angle = pi*modulo(m*j, 2*self%pieces)/self%pieces
        c(m) = c(m) + 2.0_wp*real(at_node(j)*cmplx(cos(angle), sin(angle), wp))
      end do
    end do
    if (.not. abs(c(0)) > 1.0e-10_wp*maxval(abs(c))) return
    ! Of 1/z, the multipliers, times the radius of the circle.
    call polynomial_zeros(c, multipliers, found)
    if (.not. found) return
    multipliers = pack(multipliers, abs(multipliers) > tiny(1.0_wp), &
                       [(cmplx(tiny(1.0_wp), 0.0_wp, wp), j=1, size(multipliers))])
    exponents = hill%period/(2.0_wp*pi)*log(multipliers) + self%line
  end subroutine approximations

end module viscovib_hill_path
