!> The key `coordinates` of a wanted result: which of them its table shows.
module viscovib_wanted_coordinates
  use viscovib_group_reader, only: group_reader
  use viscovib_namelist, only: lower
  implicit none
  private

  public :: read_wanted

  !> Most names that are read.
  integer, parameter :: most = 1000

contains

  !> Places of the coordinates wanted, ascending; all by default.
  subroutine read_wanted(reader, names, wanted, default)
    type(group_reader), intent(inout) :: reader
    !> All coordinates.
    character(len=*), intent(in) :: names(:)
    integer, allocatable, intent(out) :: wanted(:)
    !> Which of them if the key is absent; all without this.
    logical, intent(in), optional :: default(:)
    character(len=len(names)), allocatable :: words(:)
    logical :: named(size(names))
    integer :: i, j

    allocate (words(0))
    if (present(default)) then
      words = reader%read_words('coordinates', len(names), most, pack(names, default))
    else
      words = reader%read_words('coordinates', len(names), most, names)
    end if
    named = .false.
    do i = 1, size(words)
      j = findloc(names, lower(words(i)), 1)
      if (j == 0) then
        call reader%complain('coordinates', "coordinates: '"//trim(words(i)) &
                             //"' is none of them, must be among "//listed(names))
      else if (named(j)) then
        call reader%complain('coordinates', "coordinates: '"//trim(words(i)) &
                             //"' is there twice: must differ")
      else
        named(j) = .true.
      end if
      if (reader%status%failed()) exit
    end do
    wanted = pack([(i, i=1, size(names))], named)
  end subroutine read_wanted

  pure function listed(names)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: listed
    integer :: i
    listed = "'"//trim(names(1))//"'"
    do i = 2, size(names)
      listed = listed//", '"//trim(names(i))//"'"
    end do
  end function listed

end module viscovib_wanted_coordinates
