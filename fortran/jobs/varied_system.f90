!> A system with a varied number in its laws; the reader of scenes extends the type.
module viscovib_varied_system
  use viscovib_kinds, only: wp
  use viscovib_status, only: status_type
  use viscovib_subject, only: subject_type
  implicit none
  private

  type, abstract, public :: varied_system
  contains
    procedure(make_system), deferred :: make
  end type varied_system

  abstract interface
    !> The system and its loads with a value of the number.
    subroutine make_system(self, value, subject, status)
      import :: status_type, subject_type, varied_system, wp
      class(varied_system), intent(in) :: self
      real(wp), intent(in) :: value
      type(subject_type), intent(out) :: subject
      type(status_type), intent(out) :: status
    end subroutine make_system
  end interface

end module viscovib_varied_system
