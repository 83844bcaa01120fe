!> The linear rest of a structure by its modes: (M s^2 + C s + K)^-1 between some of its places.
module viscovib_structure_rest
  use viscovib_damped_modes, only: find_damped_modes
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_stiffness_ratio, only: hidden_modes, hidden_poles
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: rest_type, modal_damping, new_rest, is_symmetric

  !> Coordinates up to which complex modes are computed here: it takes n^4.
  integer, parameter, public :: most_coupled = 100
  !> Parts of the largest entry that are rounding.
  real(wp), parameter :: rounding = 1.0e-12_wp

  !> Damping that leaves modes uncoupled: ratios (one or one a mode), Rayleigh's factors of M and K,
  !! loss factor.
  type :: modal_damping
    real(wp), allocatable :: ratios(:)
    real(wp) :: rayleigh(2) = 0.0_wp, loss = 0.0_wp
  end type modal_damping

  !> Modes as `viscovib_compliance` has them, with shapes at the places, (n_places, n).
  type :: rest_type
    real(wp), allocatable :: squares(:), rates(:), losses(:), shapes(:, :)
    complex(wp), allocatable :: poles(:), left(:, :), right(:, :)
    !> Springs that rounding hides, a line; empty of others.
    character(len=:), allocatable :: hidden
  end type rest_type

contains

  subroutine new_rest(rest, mass, damping, stiffness, places, modal, status)
    type(rest_type), intent(out) :: rest
    !> Shape (n, n), with the linear parts of elements.
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    !> Places in terms of the coordinates, shape (n_places, n).
    real(wp), intent(in) :: places(:, :)
    type(modal_damping), intent(in) :: modal
    type(status_type), intent(out) :: status
    real(wp), dimension(size(mass, 1), size(mass, 1)) :: shapes, seen, pulled
    real(wp) :: squares(size(mass, 1)), rates(size(mass, 1)), off
    integer :: i, n

    call set_ok(status)
    n = size(mass, 1)
    rest%hidden = ''
    if (is_symmetric(stiffness) .and. is_symmetric(damping)) then
      call find_symmetric_modes(mass, stiffness, squares, shapes)
      ! Squares of frequencies that are rounding are 0: motions that no spring resists.
      pulled = matmul(abs(stiffness), abs(shapes))
      where (abs(squares) <= rounding*sum(abs(shapes)*pulled, 1)) squares = 0.0_wp
      rest%hidden = hidden_modes(squares, shapes, mass, stiffness)
      seen = matmul(transpose(shapes), matmul(damping, shapes))
      off = 0.0_wp
      do i = 1, n
        rates(i) = seen(i, i)
        seen(i, i) = 0.0_wp
      end do
      off = maxval(abs(seen))
      rates = rates + 2.0_wp*modal%ratios*sqrt(max(squares, 0.0_wp)) + modal%rayleigh(1) &
              + modal%rayleigh(2)*squares
      if (off <= rounding*maxval(abs(rates))) then
        where (abs(rates) <= rounding*maxval(abs(rates))) rates = 0.0_wp
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
    else if (n > most_coupled) then
      call fail(status, status_input_error, 'damping', 'damping: couples the modes of '//show(n) &
                //' coordinates, must do so of at most '//show(most_coupled) &
                //' here; Structure of Python takes more')
    else
      call find_coupled(rest, mass, damping + modal%rayleigh(1)*mass &
                        + modal%rayleigh(2)*stiffness, stiffness, places, status)
    end if
  end subroutine new_rest

  subroutine find_coupled(rest, mass, damping, stiffness, places, status)
    type(rest_type), intent(inout) :: rest
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :), places(:, :)
    type(status_type), intent(inout) :: status
    complex(wp) :: left(size(mass, 1), 2*size(mass, 1)), right(size(mass, 1), 2*size(mass, 1))
    real(wp) :: slowest, fastest
    logical :: found

    allocate (rest%poles(2*size(mass, 1)))
    call find_damped_modes(mass, damping, stiffness, rest%poles, left, right, found)
    if (found) then
      slowest = minval(abs(rest%poles))
      fastest = maxval(abs(rest%poles))
      if (slowest <= rounding*fastest) then
        ! Rigid bodies and springs that rounding hides look alike here.
        call fail(status, status_input_error, 'damping', 'damping: couples the modes, whose ' &
                  //'slowest has a rate of '//show(slowest)//' 1/s beside '//show(fastest) &
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
    rest%right = matmul(places, right)
    allocate (rest%squares(0), rest%rates(0), rest%losses(0), rest%shapes(size(places, 1), 0))
  end subroutine find_coupled

  pure logical function is_symmetric(matrix)
    real(wp), intent(in) :: matrix(:, :)
    is_symmetric = maxval(abs(matrix - transpose(matrix))) <= rounding*maxval(abs(matrix))
  end function is_symmetric

end module viscovib_structure_rest
