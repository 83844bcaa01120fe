!> The system of a scene with other values of one of its &parameters.
module viscovib_varied_parameter
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_law_parameters, only: read_parameters
  use viscovib_namelist, only: namelist_type
  use viscovib_number_text, only: exact
  use viscovib_scene_groups, only: place_of
  use viscovib_scene_subject, only: read_subject
  use viscovib_status, only: status_type
  use viscovib_subject, only: subject_type
  use viscovib_varied_system, only: varied_system
  implicit none
  private

  public :: varied_parameter

  type, extends(varied_system) :: varied_parameter
    type(namelist_type) :: file
    character(len=:), allocatable :: name
  contains
    procedure :: make
  end type varied_parameter

contains

  !> What a scene with this value says, read as that is.
  subroutine make(self, value, subject, status)
    class(varied_parameter), intent(in) :: self
    real(wp), intent(in) :: value
    type(subject_type), intent(out) :: subject
    type(status_type), intent(out) :: status
    type(namelist_type) :: file
    type(growing_text) :: echo
    character(len=:), allocatable :: unused
    integer :: at, i

    file = self%file
    at = place_of(file, 'parameters')
    i = file%groups(at)%find(self%name)
    file%groups(at)%entries(i)%values(1)%text = trim(exact(value))
    call read_parameters(file, unused, echo, status)
    if (.not. status%failed()) call read_subject(file, subject, echo, status)
  end subroutine make

end module viscovib_varied_parameter
