!> A free motion as a sum of decaying oscillations, by a matrix pencil of all coordinates together
!! (Hua and Sarkar, IEEE Trans. Acoust. Speech Signal Process. 38 (1990) 814).
!!
!! Rows of q_k, ..., q_(k+L) of each coordinate span the space of (1, p, ..., p^L) of all
!! exponentials p^k = exp(s t_k) in the motion. Its basis, shifted by one, gives the poles p as
!! eigenvalues; the amplitudes follow by least squares.
module viscovib_free_decay
  use viscovib_constants, only: pi
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_orthogonal, only: add_rows, least_squares, right_vectors
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: decay_type, find_free_decay

  type :: decay_type
    !> Roots s with positive imaginary part of motions Re(a exp(s t)), the largest motion first.
    complex(wp), allocatable :: roots(:)
    !> Amplitudes a of each coordinate, shape (n, n_dof).
    complex(wp), allocatable :: amplitudes(:, :)
    !> Largest residual of a coordinate relative to its largest value.
    real(wp) :: residual = 0.0_wp
  end type decay_type

  !> Largest number of columns of the pencil: the cost of longer rows is cubic, without a benefit.
  integer, parameter :: most_columns = 200
  !> Exponentials per oscillation: its pair, and two for parts that do not oscillate.
  integer, parameter :: for_each = 4
  !> States for each oscillation at least.
  integer, parameter, public :: states_for_each = 8
  !> Singular values below this part of the first are rounding.
  real(wp), parameter :: rounding = 1.0e-14_wp
  !> Number of rows that are reduced together.
  integer, parameter :: together = 256

contains

  subroutine find_free_decay(t, q, count, decay, status)
    !> Times at equal steps, shape (n), and coordinates, shape (n, n_dof).
    real(wp), intent(in) :: t(:), q(:, :)
    !> Number of oscillations.
    integer, intent(in) :: count
    type(decay_type), intent(out) :: decay
    type(status_type), intent(out) :: status
    complex(wp), allocatable :: poles(:), shares(:, :), roots(:)
    real(wp) :: sizes(size(q, 2)), step
    real(wp), allocatable :: weights(:)
    integer, allocatable :: moving(:)
    integer :: i, j, n

    call set_ok(status)
    n = size(t)
    if (n < states_for_each*count) then
      call fail(status, status_input_error, 'start', 'trajectory: '//show(n)//' states after ' &
                //'start, must be at least '//show(states_for_each*count)//' for count = ' &
                //show(count))
      return
    end if
    step = (t(n) - t(1))/(n - 1)
    if (maxval(t(2:) - t(:n - 1)) - minval(t(2:) - t(:n - 1)) > 1.0e-6_wp*step) then
      call fail(status, status_input_error, 'trajectory', 'trajectory: must be kept at equal steps')
      return
    end if
    sizes = maxval(abs(q), 1)
    moving = pack([(i, i=1, size(sizes))], sizes > 0.0_wp)
    if (size(moving) == 0) then
      call fail(status, status_input_error, 'trajectory', 'trajectory: is at rest, nothing decays')
      return
    end if
    call find_poles(q, moving, sizes, for_each*count, poles)
    call find_shares(q, poles, shares, decay%residual, sizes)
    allocate (roots, source=log(poles)/step)
    where (abs(aimag(poles)) <= 0.0_wp .and. real(poles) < 0.0_wp)
      roots = cmplx(log(abs(poles)), pi, wp)/step
    end where
    allocate (weights(size(roots)))
    do i = 1, size(roots)
      weights(i) = -1.0_wp
      if (aimag(roots(i)) > 1.0e-9_wp*abs(roots(i))) then
        weights(i) = maxval(abs(shares(i, moving))/sizes(moving))
      end if
    end do
    allocate (decay%roots(count), decay%amplitudes(count, size(q, 2)))
    do j = 1, count
      i = 0
      if (size(weights) > 0) i = maxloc(weights, 1)
      if (i > 0) then
        if (weights(i) < 0.0_wp) i = 0
      end if
      if (i == 0) then
        call fail(status, status_input_error, 'count', 'count = '//show(count)//': only ' &
                  //show(j - 1)//' oscillations are in this motion')
        return
      end if
      weights(i) = -1.0_wp
      decay%roots(j) = roots(i)
      decay%amplitudes(j, :) = shares(i, :)*exp(-roots(i)*t(1))
    end do
  end subroutine find_free_decay

  !> Factors per step of the exponentials, at most `most`.
  subroutine find_poles(q, moving, sizes, most, poles)
    real(wp), intent(in) :: q(:, :), sizes(:)
    !> Coordinates that are not at rest.
    integer, intent(in) :: moving(:), most
    complex(wp), allocatable, intent(out) :: poles(:)
    real(wp), allocatable :: r(:, :), rows(:, :), values(:), vectors(:, :), next(:, :)
    real(wp), allocatable :: matrix(:, :)
    logical :: found
    integer :: first, i, j, last, length, m, rank

    m = size(q, 1)
    length = min(m/2, most_columns)
    allocate (r(length + 1, length + 1), source=0.0_wp)
    do i = 1, size(moving)
      do first = 1, m - length, together
        last = min(first + together - 1, m - length)
        allocate (rows(last - first + 1, length + 1))
        do j = 0, length
          rows(:, j + 1) = q(first + j:last + j, moving(i))/sizes(moving(i))
        end do
        call add_rows(r, rows)
        deallocate (rows)
      end do
    end do
    call right_vectors(r, rounding, values, vectors)
    rank = min(most, size(values))
    next = vectors(2:, :rank)
    vectors = vectors(:length, :rank)
    allocate (matrix(rank, rank), poles(rank))
    call least_squares(vectors, next, matrix)
    call eigenvalues(matrix, poles, found)
    poles = pack(poles, abs(poles) > 0.0_wp)
  end subroutine find_poles

  !> Amplitudes a of Re(a p^k) in each coordinate, for one pole of each pair; 0 for its conjugate.
  subroutine find_shares(q, poles, shares, residual, sizes)
    real(wp), intent(in) :: q(:, :), sizes(:)
    complex(wp), intent(in) :: poles(:)
    !> Shape (size(poles), n_dof).
    complex(wp), allocatable, intent(out) :: shares(:, :)
    real(wp), intent(out) :: residual
    real(wp), allocatable :: basis(:, :), a(:, :), b(:, :), x(:, :)
    complex(wp) :: power
    integer :: i, k, n
    logical :: is_pair

    n = size(q, 1)
    allocate (basis(n, size(poles)), x(size(poles), size(q, 2)))
    i = 1
    do while (i <= size(poles))
      is_pair = aimag(poles(i)) > 0.0_wp .and. i < size(poles)
      do k = 1, n
        ! Growing exponentials are scaled to 1 at the end.
        power = power_of(poles(i), k - 1 - merge(n - 1, 0, abs(poles(i)) > 1.0_wp))
        basis(k, i) = real(power)
        if (is_pair) basis(k, i + 1) = -aimag(power)
      end do
      i = i + merge(2, 1, is_pair)
    end do
    a = basis
    b = q
    call least_squares(a, b, x)
    b = q - matmul(basis, x)
    residual = maxval(maxval(abs(b), 1)/sizes, sizes > 0.0_wp)
    allocate (shares(size(poles), size(q, 2)), source=(0.0_wp, 0.0_wp))
    i = 1
    do while (i <= size(poles))
      is_pair = aimag(poles(i)) > 0.0_wp .and. i < size(poles)
      shares(i, :) = x(i, :)
      if (is_pair) shares(i, :) = cmplx(x(i, :), x(i + 1, :), wp)
      if (abs(poles(i)) > 1.0_wp) shares(i, :) = shares(i, :)*power_of(poles(i), 1 - n)
      i = i + merge(2, 1, is_pair)
    end do
  end subroutine find_shares

  !> p^k by its logarithm, without overflow.
  pure complex(wp) function power_of(p, k)
    complex(wp), intent(in) :: p
    integer, intent(in) :: k
    real(wp) :: angle
    angle = atan2(aimag(p), real(p))*k
    power_of = exp(max(log(abs(p))*k, -700.0_wp))*cmplx(cos(angle), sin(angle), wp)
  end function power_of

end module viscovib_free_decay
