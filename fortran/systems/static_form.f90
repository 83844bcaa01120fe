!> Static equilibrium of the linear subsystem of a structure, also with rigid bodies.
!!
!! Forces h on the condensed coordinates and the amplitudes eta of the rigid-body modes satisfy
!!
!!   y = elastic h + seen eta + deflection by the load,   0 = pushed^T h + load of the bodies.
!!
!! The limit of H(s)^-1 at s = 0 is the block of the inverse that gives h from y.
module viscovib_static_form
  use viscovib_compliance, only: compliance_type, push_type
  use viscovib_dense, only: equilibrate, factorize, solve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: static_form, new_static_form

  !> Relative remainder of a linearly dependent row, and relative load of rigid bodies without
  !! support, that are rounding errors.
  real(wp), parameter :: dependent = 1.0e-10_wp, unsupported = 1.0e-9_wp

  type :: static_form
    !> Real modes and complex modes that are rigid bodies, and factors that make the latter real.
    integer, allocatable, private :: bodies(:), still(:)
    complex(wp), allocatable, private :: phase(:)
    !> Inverse of the bordered matrix, and the motions of rigid bodies that move the coordinates,
    !! shape (n_bodies, n).
    real(wp), allocatable, private :: inverse(:, :), moving(:, :)
  contains
    procedure :: is_held
    procedure :: find
    procedure, private :: body_loads
  end type static_form

contains

  !> Find the static form of a complete compliance, and its static stiffness.
  subroutine new_static_form(static, rest, singular)
    type(static_form), intent(out) :: static
    type(compliance_type), intent(inout) :: rest
    !> True if the coordinates depend on each other in all modes.
    logical, intent(out) :: singular
    real(wp), allocatable :: seen(:, :), pushed(:, :), border(:, :), rows(:), columns(:), bend(:)
    complex(wp), allocatable :: turning(:)
    integer, allocatable :: pivots(:)
    integer :: a, i, m, n, q

    q = rest%n_seen
    static%bodies = pack([(i, i=1, rest%n_modes)], &
                         .not. abs(rest%squares(:rest%n_modes)) > 0.0_wp)
    static%still = pack([(i, i=1, size(rest%poles))], .not. abs(rest%poles) > 0.0_wp)
    m = size(static%bodies)
    n = m + size(static%still)
    allocate (static%phase(n - m), source=(1.0_wp, 0.0_wp))
    allocate (seen(q, n), pushed(q, n))
    seen(:, :m) = transpose(rest%seen(static%bodies, :))
    pushed(:, :m) = transpose(rest%pushed(static%bodies, :))
    do i = 1, n - m
      associate (left => rest%left(static%still(i), :), right => rest%right(static%still(i), :))
        a = maxloc(abs(left), 1)
        if (abs(left(a)) > 0.0_wp) static%phase(i) = left(a)/abs(left(a))
        seen(:, m + i) = real(left/static%phase(i))
        pushed(:, m + i) = real(right*static%phase(i))
      end associate
    end do
    static%moving = row_space(seen)
    m = q + size(static%moving, 2)
    allocate (border(m, m), static%inverse(m, m), rows(m), columns(m), pivots(m))
    allocate (bend(size(rest%squares)), turning(size(rest%poles)))
    bend = 0.0_wp
    where (abs(rest%squares) > 0.0_wp) bend = 1.0_wp/rest%squares
    turning = (0.0_wp, 0.0_wp)
    where (abs(rest%poles) > 0.0_wp) turning = 1.0_wp/rest%poles
    border = 0.0_wp
    border(:q, :q) = rest%flexibility &
                     + matmul(transpose(rest%seen), spread(bend, 2, q)*rest%pushed) &
                     - real(matmul(transpose(rest%left), spread(turning, 2, q)*rest%right))
    border(:q, q + 1:) = matmul(seen, static%moving)
    border(q + 1:, :q) = transpose(matmul(pushed, static%moving))
    call equilibrate(abs(border), rows, columns)
    do i = 1, m
      border(:, i) = rows*border(:, i)*columns(i)
    end do
    call factorize(m, border, pivots, singular)
    static%inverse = 0.0_wp
    if (singular) return
    associate (inverse => static%inverse)
      do i = 1, m
        inverse(i, i) = 1.0_wp
        call solve(m, border, pivots, inverse(:, i))
      end do
      ! A stiffness against rigid motions that is a rounding error is 0.
      where (abs(inverse) <= 4.0_wp*epsilon(1.0_wp)*maxval(abs(inverse))) inverse = 0.0_wp
      do i = 1, m
        inverse(:, i) = columns*inverse(:, i)*rows(i)
      end do
    end associate
    rest%stiffness_at_rest = static%inverse(:q, :q)
  end subroutine new_static_form

  !> Orthonormal basis of the rows of a matrix, shape (n_columns, rank), by elimination of the
  !! largest row.
  pure function row_space(matrix) result(basis)
    real(wp), intent(in) :: matrix(:, :)
    real(wp), allocatable :: basis(:, :)
    real(wp) :: left(size(matrix, 1), size(matrix, 2)), row(size(matrix, 2)), largest
    integer :: i, rank

    allocate (basis(size(row), min(size(matrix, 1), size(row))))
    left = matrix
    largest = maxval(norm2(left, 2))
    do rank = 0, size(basis, 2) - 1
      i = maxloc(norm2(left, 2), 1)
      row = left(i, :)
      if (.not. norm2(row) > dependent*largest) exit
      row = row/norm2(row)
      ! The second orthogonalization removes rounding errors.
      row = row - matmul(basis(:, :rank), matmul(row, basis(:, :rank)))
      row = row/norm2(row)
      basis(:, rank + 1) = row
      do i = 1, size(left, 1)
        left(i, :) = left(i, :) - sum(left(i, :)*row)*row
      end do
    end do
    basis = basis(:, :rank)
  end function row_space

  !> True if a load on modes does not act on rigid bodies that move no coordinate.
  pure logical function is_held(self, push) result(held)
    class(static_form), intent(in) :: self
    type(push_type), intent(in) :: push
    complex(wp) :: loads(size(self%moving, 1))

    loads = self%body_loads(push)
    held = norm2(abs(loads - matmul(self%moving, matmul(loads, self%moving)))) &
           <= unsupported*norm2(abs(loads))
  end function is_held

  pure function body_loads(self, push) result(loads)
    class(static_form), intent(in) :: self
    type(push_type), intent(in) :: push
    complex(wp) :: loads(size(self%moving, 1))
    loads = [push%modes(self%bodies), self%phase*push%poles(self%still)]
  end function body_loads

  !> Forces h on the coordinates with the static deflections y, and the amplitudes of all modes.
  pure subroutine find(self, rest, y, push, h, modes, poles)
    class(static_form), intent(in) :: self
    type(compliance_type), intent(in) :: rest
    complex(wp), intent(in) :: y(:)
    !> The load.
    type(push_type), intent(in) :: push
    complex(wp), intent(out) :: h(:)
    !> Real modes, with or without padding, and complex modes.
    complex(wp), intent(out) :: modes(:), poles(:)
    complex(wp) :: found(size(self%inverse, 1)), eta(size(self%moving, 1))
    integer :: a, m, n

    n = size(modes)
    m = size(self%bodies)
    where (abs(rest%squares(:n)) > 0.0_wp)
      modes = push%modes(:n)/rest%squares(:n)
    else where
      modes = (0.0_wp, 0.0_wp)
    end where
    where (abs(rest%poles) > 0.0_wp)
      poles = -push%poles/rest%poles
    else where
      poles = (0.0_wp, 0.0_wp)
    end where
    do a = 1, size(y)
      found(a) = y(a) - push%flexible(a) - sum(rest%seen(:n, a)*modes) - sum(rest%left(:, a)*poles)
    end do
    found(size(y) + 1:) = -matmul(self%body_loads(push), self%moving)
    found = matmul(self%inverse, found)
    h = found(:size(y))
    where (abs(rest%squares(:n)) > 0.0_wp) modes = (push%modes(:n) &
                                                    + matmul(rest%pushed(:n, :), h)) &
                                                   /rest%squares(:n)
    where (abs(rest%poles) > 0.0_wp) poles = -(push%poles + matmul(rest%right, h))/rest%poles
    eta = matmul(self%moving, found(size(y) + 1:))
    modes(self%bodies) = eta(:m)
    poles(self%still) = eta(m + 1:)/self%phase
  end subroutine find

end module viscovib_static_form
