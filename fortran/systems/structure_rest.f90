!> Linear subsystem of a structure by modes: (M s^2 + C s + K)^-1 between observed coordinates.
!!
!! Coordinates without mass (0) carry no other forces. They follow the other coordinates (1)
!! statically, u_0 = -K_00^-1 K_01 u_1. This leaves the stiffness K_11 - K_10 K_00^-1 K_01 (Guyan,
!! AIAA Journal 3 (1965) 380, exact here).
module viscovib_structure_rest
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_damped_modes, only: find_damped_modes
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_stiffness_ratio, only: entries_of, hidden_modes, hidden_poles, least_hidden
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: rest_type, modal_damping, new_rest, is_symmetric

  !> Largest number of coordinates for complex modes; the time grows as n^4.
  integer, parameter, public :: most_coupled = 100
  !> Fraction of the terms of a sum that counts as rounding error.
  real(wp), parameter :: rounding = 1.0e-12_wp
  !> A diagonal entry larger than this multiple of all others is a penalty support. It would destroy
  !! the digits of the other coordinates.
  real(wp), parameter :: huge_ratio = 1.0e20_wp

  !> Damping that does not couple modes: ratios (one, or one per mode), Rayleigh factors of M and K,
  !! loss factor.
  type :: modal_damping
    real(wp), allocatable :: ratios(:)
    real(wp) :: rayleigh(2) = 0.0_wp, loss = 0.0_wp
  end type modal_damping

  !> Modes as in `viscovib_compliance`, with shapes at observed coordinates, shape (n_places, n).
  type :: rest_type
    real(wp), allocatable :: squares(:), rates(:), losses(:), shapes(:, :)
    complex(wp), allocatable :: poles(:), left(:, :), right(:, :)
    !> K, shape (n, n); empty if there are coordinates without mass.
    real(wp), allocatable :: springs(:, :)
    !> Rounding error of K; not allocated: 0.
    real(wp), allocatable :: springs_low(:, :)
    !> Warning about soft springs hidden by rounding errors; empty if there are none.
    character(len=:), allocatable :: hidden
    !> Mask of coordinates without mass, and matrix that gives them from the other coordinates.
    logical, allocatable :: idle(:)
    real(wp), allocatable :: follow(:, :)
  contains
    procedure :: n_modes
    procedure :: refuse_on_idle
    procedure :: place_idle
    procedure :: in_modes
  end type rest_type

contains

  subroutine new_rest(rest, mass, damping, stiffness, places, modal, status, low, roughly)
    type(rest_type), intent(out) :: rest
    !> Shape (n, n), including the linear parts of elements.
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    !> Observed coordinates in terms of all coordinates, shape (n_places, n).
    real(wp), intent(in) :: places(:, :)
    type(modal_damping), intent(in) :: modal
    type(status_type), intent(out) :: status
    !> Rounding error of the stiffness.
    real(wp), intent(in) :: low(:, :)
    !> If true, complex modes of any number of coordinates, as of `find_damped_modes`.
    logical, intent(in), optional :: roughly

    call set_ok(status)
    call refuse_penalty(mass, 'mass', status)
    call refuse_penalty(stiffness, 'stiffness', status)
    if (status%failed()) return
    rest%idle = .not. any(abs(mass) > 0.0_wp, 2)
    if (any(rest%idle)) then
      allocate (rest%springs(0, 0))
      call find_condensed(rest, mass, damping, stiffness, places, modal, status)
    else
      allocate (rest%follow(0, size(mass, 1)))
      rest%springs = stiffness
      rest%springs_low = low
      call find_modes(rest, mass, damping, stiffness, places, places, modal, status, roughly)
    end if
  end subroutine new_rest

  !> Fail if a very large diagonal entry fixes a coordinate.
  subroutine refuse_penalty(matrix, name, status)
    real(wp), intent(in) :: matrix(:, :)
    character(len=*), intent(in) :: name
    type(status_type), intent(inout) :: status
    real(wp) :: diagonal(size(matrix, 1)), next
    integer :: i

    diagonal = [(abs(matrix(i, i)), i=1, size(diagonal))]
    do i = 1, size(diagonal)
      next = maxval(diagonal, mask=diagonal < diagonal(i)/huge_ratio)
      if (.not. next > 0.0_wp .or. status%failed()) cycle
      if (any(diagonal >= diagonal(i)/huge_ratio .and. diagonal <= next*huge_ratio &
              .and. diagonal > next)) cycle
      call fail(status, status_input_error, name, name//': coordinate '//show(i)//' has ' &
                //show(diagonal(i))//' on the diagonal, more than '//show(huge_ratio) &
                //' times as much as others; for a support remove its row and column')
    end do
  end subroutine refuse_penalty

  !> Modes of the coordinates with mass. The others follow statically at the observed coordinates.
  subroutine find_condensed(rest, mass, damping, stiffness, places, modal, status)
    type(rest_type), intent(inout) :: rest
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :), places(:, :)
    type(modal_damping), intent(in) :: modal
    type(status_type), intent(inout) :: status
    real(wp), dimension(count(rest%idle), count(rest%idle)) :: inner, inverse
    real(wp), dimension(count(.not. rest%idle), count(.not. rest%idle)) :: left
    real(wp) :: carry(count(rest%idle), count(.not. rest%idle))
    real(wp), dimension(size(places, 1), count(.not. rest%idle)) :: whole, pushed
    integer :: kept(count(.not. rest%idle)), gone(count(rest%idle)), pivots(count(rest%idle))
    character(len=:), allocatable :: without
    integer :: i, m
    logical :: singular

    gone = pack([(i, i=1, size(mass, 1))], rest%idle)
    kept = pack([(i, i=1, size(mass, 1))], .not. rest%idle)
    m = size(gone)
    do i = m, 1, -1
      if (any(abs(damping(:, gone(i))) > 0.0_wp) .or. any(abs(damping(gone(i), :)) > 0.0_wp)) then
        call fail(status, status_input_error, 'damping', 'damping: coordinate '//show(gone(i)) &
                  //' has no mass, and must not have damping either')
      end if
    end do
    without = ' damps coordinate '//show(gone(1))//', which has no mass: must be 0 here; ' &
              //'Structure of Python takes it'
    if (status%failed()) return
    if (abs(modal%rayleigh(2)) > 0.0_wp) then
      call fail(status, status_input_error, 'rayleigh', 'rayleigh: its factor of the stiffness' &
                //without)
    else if (abs(modal%loss) > 0.0_wp) then
      call fail(status, status_input_error, 'loss_factor', 'loss_factor: it'//without)
    end if
    if (status%failed()) return
    inner = stiffness(gone, gone)
    inverse = 0.0_wp
    call factorize(m, inner, pivots, singular)
    do i = 1, merge(0, m, singular)
      inverse(i, i) = 1.0_wp
      call solve(m, inner, pivots, inverse(:, i))
    end do
    if (.not. singular) singular = norm(stiffness(gone, gone))*norm(inverse) > 1.0_wp/rounding
    if (singular) then
      call fail(status, status_input_error, 'mass', 'mass: a coordinate has neither mass nor ' &
                //'stiffness')
      return
    end if
    rest%follow = -matmul(inverse, stiffness(gone, kept))
    carry = -matmul(transpose(inverse), transpose(stiffness(kept, gone)))
    left = stiffness(kept, kept) + matmul(stiffness(kept, gone), rest%follow)
    ! Keep the matrix symmetric in the presence of rounding errors.
    if (is_symmetric(stiffness)) left = 0.5_wp*(left + transpose(left))
    whole = places(:, kept) + matmul(places(:, gone), rest%follow)
    pushed = places(:, kept) + matmul(places(:, gone), carry)
    call find_modes(rest, mass(kept, kept), damping(kept, kept), left, whole, pushed, modal, status)

  contains

    !> Largest sum of a column.
    pure real(wp) function norm(matrix)
      real(wp), intent(in) :: matrix(:, :)
      norm = maxval(sum(abs(matrix), 1))
    end function norm

  end subroutine find_condensed

  pure integer function n_modes(self)
    class(rest_type), intent(in) :: self
    n_modes = size(self%squares) + size(self%poles)/2
  end function n_modes

  !> Fail if a force other than the modes can represent acts on a coordinate without mass.
  subroutine refuse_on_idle(self, forces, subject, what, status)
    class(rest_type), intent(in) :: self
    !> Forces on the coordinates, shape (n, n_forces).
    real(wp), intent(in) :: forces(:, :)
    character(len=*), intent(in) :: subject, what
    type(status_type), intent(out) :: status
    integer :: i

    call set_ok(status)
    if (.not. any(self%idle)) return
    i = findloc(self%idle .and. any(abs(forces) > 0.0_wp, 2), .true., 1)
    if (i > 0) call fail(status, status_input_error, subject, what//' acts on coordinate ' &
                         //show(i)//', which has no mass: must be one with mass here; ' &
                         //'Structure of Python takes it')
  end subroutine refuse_on_idle

  !> Set the coordinates without mass from the others.
  pure subroutine place_idle(self, u)
    class(rest_type), intent(in) :: self
    real(wp), intent(inout) :: u(:)
    if (any(self%idle)) u = unpack(matmul(self%follow, pack(u, .not. self%idle)), self%idle, u)
  end subroutine place_idle

  !> Modal coordinates of real modes, and states of complex modes, for displacements u. There are
  !! two equivalent formulas,
  !!
  !!   phi^T M u = phi^T K u/omega^2,    right^T (pole M + C) u = -right^T K u/pole.
  !!
  !! Each mode uses the one with the smaller rounding error. Displacements that hardly deform a
  !! stiff spring hardly excite its mode. K u is exact, but phi^T M u may have an error of 1e-16,
  !! which then oscillates.
  pure subroutine in_modes(self, mass, damped, u, q, z)
    class(rest_type), intent(in) :: self
    !> Shape (n, n), C u, and u.
    real(wp), intent(in) :: mass(:, :), damped(:), u(:)
    !> One value per mode.
    real(wp), intent(out) :: q(:)
    complex(wp), intent(out) :: z(:)
    real(wp), dimension(size(u)) :: moved, moved_most, pulled
    real(real128) :: total(size(u))
    real(wp) :: lost, bent
    integer :: i, k

    moved = matmul(mass, u)
    q = matmul(moved, self%shapes)
    z = self%poles*matmul(moved, self%right) + matmul(damped, self%right)
    if (size(self%springs) == 0 .or. .not. any(abs(u) > 0.0_wp)) return
    moved_most = matmul(abs(mass), abs(u))
    total = 0.0_real128
    do k = 1, size(u)
      do i = 1, size(u)
        associate (spring => self%springs(i, k), low => self%springs_low(i, k))
          if (.not. (abs(spring) > 0.0_wp .or. abs(low) > 0.0_wp)) cycle
          total(i) = total(i) + (real(spring, real128) + low)*u(k)
        end associate
      end do
    end do
    pulled = real(total, wp)
    do i = 1, size(q)
      lost = self%squares(i)*sum(abs(self%shapes(:, i))*moved_most)
      bent = sum(abs(self%shapes(:, i))*abs(pulled))
      if (bent < lost) q(i) = sum(self%shapes(:, i)*pulled)/self%squares(i)
    end do
    do i = 1, size(z)
      lost = abs(self%poles(i))*(abs(self%poles(i))*sum(abs(self%right(:, i))*moved_most) &
                                 + sum(abs(self%right(:, i))*abs(damped)))
      bent = sum(abs(self%right(:, i))*abs(pulled))
      if (bent < lost) z(i) = -sum(self%right(:, i)*pulled)/self%poles(i)
    end do
  end subroutine in_modes

  subroutine find_modes(rest, mass, damping, stiffness, places, pushed, modal, status, roughly)
    type(rest_type), intent(inout) :: rest
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    !> Matrices from coordinates to observed coordinates, and from forces there to the coordinates.
    real(wp), intent(in) :: places(:, :), pushed(:, :)
    type(modal_damping), intent(in) :: modal
    type(status_type), intent(inout) :: status
    logical, intent(in), optional :: roughly
    logical :: rough
    real(wp), dimension(size(mass, 1), size(mass, 1)) :: shapes, seen, pulled, lost
    real(wp) :: squares(size(mass, 1)), rates(size(mass, 1))
    integer :: i, n

    n = size(mass, 1)
    rest%hidden = ''
    rough = .false.
    if (present(roughly)) rough = roughly
    if (is_symmetric(stiffness) .and. is_symmetric(damping)) then
      call find_symmetric_modes(mass, stiffness, squares, shapes, rest%springs_low)
      ! Set squares within rounding errors to 0: rigid-body modes.
      pulled = matmul(abs(stiffness), abs(shapes))
      where (abs(squares) <= rounding*sum(abs(shapes)*pulled, 1)) squares = 0.0_wp
      rest%hidden = hidden_modes(squares, shapes, [(mass(i, i), i=1, n)], entries_of(stiffness), &
                                 least_hidden, 1)
      seen = matmul(transpose(shapes), matmul(damping, shapes))
      ! Compare each product with its own terms, so that a strong damper does not hide weak ones.
      lost = rounding*matmul(transpose(abs(shapes)), matmul(abs(damping), abs(shapes)))
      where (abs(seen) <= lost) seen = 0.0_wp
      do i = 1, n
        rates(i) = seen(i, i)
        seen(i, i) = 0.0_wp
      end do
      rates = rates + 2.0_wp*modal%ratios*sqrt(max(squares, 0.0_wp)) + modal%rayleigh(1) &
              + modal%rayleigh(2)*squares
      if (all(abs(seen) <= 0.0_wp)) then
        rest%squares = squares
        rest%rates = rates
        rest%losses = spread(modal%loss, 1, n)
        rest%shapes = matmul(places, shapes)
        allocate (rest%poles(0), rest%left(size(places, 1), 0), rest%right(size(places, 1), 0))
        return
      end if
    end if
    if (any(abs(modal%ratios) > 0.0_wp) .or. abs(modal%loss) > 0.0_wp) then
      call fail(status, status_input_error, 'damping', 'damping: modal_damping and loss_factor ' &
                //'need symmetric matrices that leave the modes uncoupled')
    else if (n > most_coupled .and. .not. rough) then
      call fail(status, status_input_error, 'damping', 'damping: couples the modes of '//show(n) &
                //' coordinates, must do so of at most '//show(most_coupled) &
                //' here; Structure of Python takes more')
    else
      call find_coupled(rest, mass, damping + modal%rayleigh(1)*mass &
                        + modal%rayleigh(2)*stiffness, stiffness, places, pushed, status, rough)
    end if
  end subroutine find_modes

  subroutine find_coupled(rest, mass, damping, stiffness, places, pushed, status, rough)
    type(rest_type), intent(inout) :: rest
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :), places(:, :), pushed(:, :)
    type(status_type), intent(inout) :: status
    logical, intent(in) :: rough
    complex(wp) :: left(size(mass, 1), 2*size(mass, 1)), right(size(mass, 1), 2*size(mass, 1))
    real(wp) :: slowest, fastest
    logical :: found

    allocate (rest%poles(2*size(mass, 1)))
    call find_damped_modes(mass, damping, stiffness, rest%poles, left, right, found, &
                           rest%springs_low, rough)
    if (found) then
      slowest = minval(abs(rest%poles))
      fastest = maxval(abs(rest%poles))
      if (slowest <= rounding*fastest) then
        ! Rigid bodies and springs hidden by rounding errors cannot be distinguished here.
        call fail(status, status_input_error, 'damping', 'damping: couples the modes, whose ' &
                  //'slowest has a rate of '//show(slowest)//' 1/s, the fastest '//show(fastest) &
                  //' 1/s: a rigid body, or so soft that rounding hides it; the ratio must be ' &
                  //'above '//show(rounding)//', or the damping leave the modes uncoupled')
        return
      end if
    end if
    if (.not. found) then
      call fail(status, status_input_error, 'damping', 'damping: couples modes that coincide, ' &
                //'as rigid bodies do, or of so different stiffness that rounding makes them so; ' &
                //'this program does not find their sum: must leave the modes uncoupled, or see ' &
                //'Structure of Python')
      return
    end if
    rest%hidden = hidden_poles(rest%poles, left, right, stiffness)
    rest%left = matmul(places, left)
    rest%right = matmul(pushed, right)
    allocate (rest%squares(0), rest%rates(0), rest%losses(0), rest%shapes(size(places, 1), 0))
  end subroutine find_coupled

  !> True if symmetric within rounding errors of the entry, diagonal and largest entry.
  pure logical function is_symmetric(matrix)
    real(wp), intent(in) :: matrix(:, :)
    real(wp) :: nearby, least
    integer :: i, j

    is_symmetric = .true.
    least = 4.0_wp*epsilon(1.0_wp)*maxval(abs(matrix))
    do j = 1, size(matrix, 1)
      do i = 1, j - 1
        nearby = max(abs(matrix(i, j)), abs(matrix(j, i)), &
                     sqrt(abs(matrix(i, i)))*sqrt(abs(matrix(j, j))))
        if (abs(matrix(i, j) - matrix(j, i)) > rounding*nearby + least) is_symmetric = .false.
      end do
    end do
  end function is_symmetric

end module viscovib_structure_rest
