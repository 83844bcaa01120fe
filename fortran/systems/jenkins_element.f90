! Optimize: -O1
!> Jenkins elements in parallel (Iwan's model): springs, each in series with a slider.
!!
!!   z_j' = k_j d' where |z_j| < F_j, else z_j = +-F_j.
module viscovib_jenkins_element
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: jenkins_element, new_jenkins

  type, extends(hysteresis_type) :: jenkins_element
    !> k_j (N/m) and F_j (N).
    real(wp), allocatable, private :: stiffness(:), limit(:)
  contains
    procedure :: advance
    procedure :: slope
    procedure :: kinks
  end type jenkins_element

contains

  !> From k_1, F_1, k_2, F_2, ...
  pure subroutine new_jenkins(element, numbers)
    type(jenkins_element), intent(out) :: element
    real(wp), intent(in) :: numbers(:)
    integer :: n
    n = size(numbers)/2
    element%stiffness = numbers(1:2*n:2)
    element%limit = numbers(2:2*n:2)
    allocate (element%weight(n), source=1.0_wp)
  end subroutine new_jenkins

  pure subroutine advance(self, change, z, by_z, by_d, work)
    class(jenkins_element), intent(in) :: self
    real(wp), intent(in) :: change
    real(wp), intent(inout) :: z(:)
    real(wp), intent(out) :: by_z(:), by_d(:), work
    real(wp) :: wanted, before
    integer :: j

    work = 0.0_wp
    do j = 1, size(z)
      before = z(j)
      wanted = before + self%stiffness(j)*change
      z(j) = min(max(wanted, -self%limit(j)), self%limit(j))
      if (abs(wanted) > self%limit(j)) then
        by_z(j) = 0.0_wp
        by_d(j) = 0.0_wp
      else
        by_z(j) = 1.0_wp
        by_d(j) = self%stiffness(j)
      end if
      ! Work while the slider sticks and while it slides.
      work = work + (0.5_wp*(z(j) + before)*(z(j) - before) + z(j)*(wanted - z(j))) &
             /self%stiffness(j)
    end do
  end subroutine advance

  pure subroutine slope(self, z, way, slopes, by_z)
    class(jenkins_element), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: slopes(:), by_z(:)
    slopes = merge(self%stiffness, 0.0_wp, way*z < self%limit)
    by_z = 0.0_wp
  end subroutine slope

  pure subroutine kinks(self, z, way, distances)
    class(jenkins_element), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: distances(:)
    distances = (self%limit - way*z)/self%stiffness
    where (.not. distances > 0.0_wp) distances = huge(1.0_wp)
  end subroutine kinks

end module viscovib_jenkins_element
