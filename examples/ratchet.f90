! Optimize: -O3
!> A slider with different force limits for both directions, as a belt over teeth:
!!
!!   z' = k d' where -F_back < z < F_ahead, else z stays at its limit.
module ratchet_element
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: show
  implicit none
  private

  public :: ratchet, new_ratchet, ratchet_fault, ratchet_odd, ratchet_parameters

  !> Names of its numbers, in the order of the arguments in Python.
  character(len=*), parameter :: ratchet_parameters = 'stiffness ahead back'
  !> True if the opposite path always gives the opposite force.
  logical, parameter :: ratchet_odd = .false.

  type, extends(hysteresis_type) :: ratchet
    !> k (N/m), F_ahead and F_back (N).
    real(wp), private :: stiffness = 0.0_wp, ahead = 0.0_wp, back = 0.0_wp
  contains
    procedure :: advance
    procedure :: slope
    procedure :: kinks
  end type ratchet

contains

  !> The element with the numbers k, F_ahead, F_back.
  pure subroutine new_ratchet(element, numbers)
    type(ratchet), intent(out) :: element
    real(wp), intent(in) :: numbers(:)
    element%stiffness = numbers(1)
    element%ahead = numbers(2)
    element%back = numbers(3)
    allocate (element%weight(1), source=1.0_wp)
  end subroutine new_ratchet

  !> A message for invalid numbers; empty if they are valid.
  pure function ratchet_fault(numbers) result(fault)
    real(wp), intent(in) :: numbers(:)
    character(len=:), allocatable :: fault
    fault = ''
    if (numbers(1) <= 0.0_wp) fault = 'stiffness = '//show(numbers(1))//': must be greater than 0'
    if (numbers(2) <= 0.0_wp) fault = 'ahead = '//show(numbers(2))//': must be greater than 0'
    if (numbers(3) <= 0.0_wp) fault = 'back = '//show(numbers(3))//': must be greater than 0'
  end function ratchet_fault

  pure subroutine advance(self, change, z, by_z, by_d, work)
    class(ratchet), intent(in) :: self
    real(wp), intent(in) :: change
    real(wp), intent(inout) :: z(:)
    real(wp), intent(out) :: by_z(:), by_d(:), work
    real(wp) :: before, wanted

    before = z(1)
    wanted = before + self%stiffness*change
    z(1) = min(max(wanted, -self%back), self%ahead)
    if (wanted > self%ahead .or. wanted < -self%back) then
      by_z(1) = 0.0_wp
      by_d(1) = 0.0_wp
    else
      by_z(1) = 1.0_wp
      by_d(1) = self%stiffness
    end if
    ! First the sticking part of the path, then the sliding part.
    work = (0.5_wp*(z(1) + before)*(z(1) - before) + z(1)*(wanted - z(1)))/self%stiffness
  end subroutine advance

  pure subroutine slope(self, z, way, slopes, by_z)
    class(ratchet), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: slopes(:), by_z(:)
    slopes(1) = 0.0_wp
    if (way*z(1) < merge(self%ahead, self%back, way > 0)) slopes(1) = self%stiffness
    by_z(1) = 0.0_wp
  end subroutine slope

  pure subroutine kinks(self, z, way, distances)
    class(ratchet), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: distances(:)
    distances(1) = (merge(self%ahead, self%back, way > 0) - way*z(1))/self%stiffness
    if (.not. distances(1) > 0.0_wp) distances(1) = huge(1.0_wp)
  end subroutine kinks

end module ratchet_element
