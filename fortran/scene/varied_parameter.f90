!> The &system or &structure of a scene with other values of one of its &parameters.
module viscovib_varied_parameter
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_law_parameters, only: read_parameters
  use viscovib_namelist, only: namelist_type
  use viscovib_number_text, only: exact
  use viscovib_polynomial, only: polynomial_type
  use viscovib_scene_groups, only: place_of
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_groups, only: read_structure
  use viscovib_structure_model, only: structure_model
  use viscovib_subject, only: name_length
  use viscovib_system_groups, only: read_system
  use viscovib_varied_system, only: varied_system
  use viscovib_whole_structure, only: whole_polynomial
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
  subroutine make(self, value, system, status)
    class(varied_parameter), intent(in) :: self
    real(wp), intent(in) :: value
    type(polynomial_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(namelist_type) :: file
    type(growing_text) :: echo
    character(len=:), allocatable :: unused
    character(len=name_length), allocatable :: coordinates(:), units(:)
    type(structure_model) :: model
    type(structure_type) :: condensed
    integer :: at, i

    file = self%file
    at = place_of(file, 'parameters')
    i = file%groups(at)%find(self%name)
    file%groups(at)%entries(i)%values(1)%text = trim(exact(value))
    call read_parameters(file, unused, echo, status)
    if (status%failed()) return
    if (place_of(file, 'structure') > size(file%groups)) then
      call read_system(file, system, coordinates, units, echo, status)
    else
      call read_structure(file, model, condensed, coordinates, units, echo, status)
      if (.not. status%failed()) call whole_polynomial(model, condensed%kernels, system, status)
    end if
    if (status%failed()) return
    do i = 1, size(system%laws)
      if (system%laws(i)%program%n_surfaces() == 0) cycle
      call fail(status, status_input_error, 'vary', self%name//' = '//show(value)//': a law is ' &
                //'not smooth, must be smooth')
      return
    end do
  end subroutine make

end module viscovib_varied_parameter
