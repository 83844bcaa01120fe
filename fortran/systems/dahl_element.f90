!> Dahl's friction: the stiffness decreases as the force approaches its limit.
!!
!!   df/dd = s (1 - way f/F_c)^i
!!
!! (Dahl, The Aerospace Corporation, TOR-0158, 1968). With y = 1 - way f/F_c and a path
!! x = way (d - d_0) it is dy/dx = -a y^i, a = s/F_c, which has the closed solution
!! y^(1-i) = y_0^(1-i) + (i - 1) a x, for i = 1 y = y_0 exp(-a x).
module viscovib_dahl_element
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: dahl_element, new_dahl

  type, extends(hysteresis_type) :: dahl_element
    !> s (N/m), F_c (N), i.
    real(wp), private :: stiffness = 0.0_wp, limit = 0.0_wp, exponent = 1.0_wp
  contains
    procedure :: advance
    procedure :: slope
    procedure :: kinks
  end type dahl_element

  !> Exponents closer than `same` are treated as equal; smallest y.
  real(wp), parameter :: same = 1.0e-9_wp, least = 1.0e-30_wp

contains

  !> From s, F_c, i.
  pure subroutine new_dahl(element, numbers)
    type(dahl_element), intent(out) :: element
    real(wp), intent(in) :: numbers(:)
    element%stiffness = numbers(1)
    element%limit = numbers(2)
    element%exponent = numbers(3)
    allocate (element%weight(1), source=1.0_wp)
  end subroutine new_dahl

  pure subroutine advance(self, change, z, by_z, by_d, work)
    class(dahl_element), intent(in) :: self
    real(wp), intent(in) :: change
    real(wp), intent(inout) :: z(:)
    real(wp), intent(out) :: by_z(:), by_d(:), work
    real(wp) :: a, x, y0, y, covered
    integer :: way

    way = merge(1, -1, change >= 0.0_wp)
    x = abs(change)
    a = self%stiffness/self%limit
    y0 = max(1.0_wp - way*z(1)/self%limit, 0.0_wp)
    by_z(1) = 1.0_wp
    y = y0
    covered = 0.0_wp
    associate (i => self%exponent)
      if (y0 > least) then
        if (abs(i - 1.0_wp) <= same) then
          y = y0*exp(-a*x)
          by_z(1) = exp(-a*x)
        else
          y = max(y0**(1.0_wp - i) + (i - 1.0_wp)*a*x, 0.0_wp)**(1.0_wp/(1.0_wp - i))
          by_z(1) = (y/y0)**i
        end if
        ! Integral of y over the path.
        if (abs(i - 2.0_wp) <= same) then
          covered = log(y0/y)/a
        else
          covered = (y0**(2.0_wp - i) - y**(2.0_wp - i))/(a*(2.0_wp - i))
        end if
      else if (i <= 1.0_wp) then
        by_z(1) = merge(exp(-a*x), 0.0_wp, abs(i - 1.0_wp) <= same)
      end if
      by_d(1) = 0.0_wp
      if (y > least) by_d(1) = self%stiffness*y**i
    end associate
    z(1) = way*self%limit*(1.0_wp - y)
    work = self%limit*(x - covered)
  end subroutine advance

  pure subroutine slope(self, z, way, slopes, by_z)
    class(dahl_element), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: slopes(:), by_z(:)
    real(wp) :: y

    y = 1.0_wp - way*z(1)/self%limit
    slopes = 0.0_wp
    by_z = 0.0_wp
    if (.not. y > least) return
    slopes(1) = self%stiffness*y**self%exponent
    by_z(1) = -way*self%stiffness*self%exponent*y**(self%exponent - 1.0_wp)/self%limit
  end subroutine slope

  !> For exponents below 1 the force reaches its limit at a finite distance.
  pure subroutine kinks(self, z, way, distances)
    class(dahl_element), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: distances(:)
    real(wp) :: y

    distances = huge(1.0_wp)
    y = 1.0_wp - way*z(1)/self%limit
    if (self%exponent >= 1.0_wp - same .or. .not. y > least) return
    distances(1) = y**(1.0_wp - self%exponent)*self%limit &
                   /(self%stiffness*(1.0_wp - self%exponent))
  end subroutine kinks

end module viscovib_dahl_element
