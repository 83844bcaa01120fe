!> A polynomial system with a varied number in its laws; the reader of laws extends the type.
module viscovib_varied_system
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: status_type
  implicit none
  private

  type, abstract, public :: varied_system
  contains
    procedure(make_system), deferred :: make
  end type varied_system

  abstract interface
    !> The system with a value of the number.
    subroutine make_system(self, value, system, status)
      import :: varied_system, wp, polynomial_type, status_type
      class(varied_system), intent(in) :: self
      real(wp), intent(in) :: value
      type(polynomial_type), intent(out) :: system
      type(status_type), intent(out) :: status
    end subroutine make_system
  end interface

end module viscovib_varied_system
