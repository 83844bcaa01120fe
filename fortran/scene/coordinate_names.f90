!> The keys `coordinates` and `units` of a system of one's own, and `kernel` of what belongs to it.
module viscovib_coordinate_names
  use viscovib_group_reader, only: group_reader
  use viscovib_namelist, only: lower
  use viscovib_status, only: show
  use viscovib_subject, only: name_length
  implicit none
  private

  public :: read_coordinates, read_units, read_kernel_place, some

  integer, parameter :: most_units = 1000

contains

  !> Names that differ, in small letters.
  subroutine read_coordinates(reader, most, coordinates, default)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: most
    character(len=name_length), allocatable, intent(out) :: coordinates(:)
    character(len=*), intent(in), optional :: default(:)
    integer :: i, j

    allocate (coordinates(0))
    if (present(default)) then
      coordinates = reader%read_words('coordinates', name_length, most, default)
    else
      coordinates = reader%read_words('coordinates', name_length, most)
    end if
    ! As all words of a scene, small and capital letters are the same.
    do i = 1, size(coordinates)
      coordinates(i) = lower(coordinates(i))
      if (.not. is_name(trim(coordinates(i)))) then
        call reader%complain('coordinates', "coordinates: '"//trim(coordinates(i)) &
                             //"' must be letters, digits and _, not begin with a digit, nor be " &
                             //'t or end in _dot')
      end if
      do j = 1, i - 1
        if (coordinates(i) == coordinates(j)) then
          call reader%complain('coordinates', "coordinates: '"//trim(coordinates(i)) &
                               //"' is there twice: must differ")
        end if
      end do
    end do
  end subroutine read_coordinates

  !> One a coordinate.
  subroutine read_units(reader, n, units)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n
    character(len=name_length), allocatable, intent(out) :: units(:)
    integer :: i

    allocate (units(0))
    units = reader%read_words('units', name_length, most_units, [(repeat('m', 1), i=1, n)])
    if (size(units) /= n) call reader%complain('units', 'units: '//show(size(units)) &
                                               //' texts, must be '//show(n) &
                                               //', one per coordinate')
  end subroutine read_units

  pure logical function is_name(text)
    character(len=*), intent(in) :: text
    character(len=*), parameter :: letters = &
      'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_'
    is_name = len(text) > 0 .and. verify(text, letters//'0123456789') == 0
    if (is_name) is_name = scan(text(1:1), letters) > 0 .and. text /= 't' &
                           .and. index(text//' ', '_dot ') == 0
  end function is_name

  !> Which &kernel acts, counted from 1; 0: none.
  integer function read_kernel_place(reader, n_kernels) result(place)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n_kernels
    place = reader%read_integer('kernel', min(n_kernels, 1))
    if (place < 0 .or. place > n_kernels) then
      call reader%complain('kernel', 'kernel = '//show(place)//': must be 0 (none) to ' &
                           //show(n_kernels)//', the place of a &kernel group')
      place = 0
    end if
  end function read_kernel_place

  !> The first names of a list.
  pure function some(names)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: some
    integer :: i
    some = trim(names(1))
    do i = 2, min(size(names), 4)
      some = some//', '//trim(names(i))
    end do
    if (size(names) > 4) some = some//', ...'
  end function some

end module viscovib_coordinate_names
