! Optimize: -O3
!> Numbers, arrays and texts by name: the input and output of a task of the interface.
!!
!! All numbers are in one array in the order of their names; a complex number takes two. Numbers of
!! a caller are only copied if they are kept longer than a call.
module viscovib_named_values
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_loc
  use viscovib_kinds, only: i8, wp
  implicit none
  private

  public :: named_values, value_place

  !> Kinds of values.
  integer, parameter, public :: real_value = 1, complex_value = 2, integer_value = 3, &
                                text_value = 4
  !> Largest number of dimensions; largest length of a name.
  integer, parameter, public :: most_dimensions = 4, longest_name = 32

  !> Location of a value.
  type :: value_place
    character(len=longest_name) :: name = ''
    integer :: name_length = 0
    integer :: kind = 0, rank = 0, extents(most_dimensions) = 1
    !> Numbers of elements before it, and of its own: numbers, integers or letters.
    integer(i8) :: before = 0, size = 0
  end type value_place

  type :: named_values
    type(value_place), allocatable :: places(:)
    integer :: n = 0
    !> All numbers: `own_numbers`, or those of a caller during its call.
    real(wp), pointer, contiguous :: numbers(:) => null()
    real(wp), allocatable, private :: own_numbers(:)
    integer(i8), allocatable :: integers(:)
    character(len=:), allocatable :: letters
    integer(i8) :: n_numbers = 0, n_integers = 0, n_letters = 0
    !> Index of the last value found, since callers usually read values in order.
    integer, private :: latest = 0
  contains
    procedure :: find
    procedure :: declare
    procedure :: keep_numbers
    procedure :: address
    procedure :: reals_at
    procedure :: complexes_at
    procedure :: put_reals
    procedure :: put_complexes
    procedure :: new_complexes
    procedure :: put_integers
    procedure :: put_longs
    procedure :: put_text
    procedure :: put_real
    procedure :: put_integer
  end type named_values

  ! Target for an array without elements.
  complex(wp), target :: no_complexes(0)

contains

  !> Index of a value; 0: it does not exist.
  integer function find(self, name) result(place)
    class(named_values), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer :: first, i
    ! Threads may search values of an object concurrently.
    first = self%latest
    do i = 1, self%n
      place = modulo(first + i - 1, self%n) + 1
      ! Different lengths are most of the comparisons.
      if (self%places(place)%name_length /= len(name)) cycle
      if (self%places(place)%name == name) then
        self%latest = place
        return
      end if
    end do
    place = 0
  end function find

  !> Declare the next value. Its elements follow those of the previous values.
  subroutine declare(self, name, kind, extents)
    class(named_values), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: kind
    !> Size 0: a single value.
    integer, intent(in) :: extents(:)
    type(value_place), allocatable :: more(:)

    if (.not. allocated(self%places)) allocate (self%places(16))
    if (self%n == size(self%places)) then
      allocate (more(2*self%n))
      more(:self%n) = self%places
      call move_alloc(more, self%places)
    end if
    self%n = self%n + 1
    associate (place => self%places(self%n))
      place%name = name
      place%name_length = len(name)
      place%kind = kind
      place%rank = size(extents)
      place%extents = 1
      place%extents(:place%rank) = extents
      place%size = product(int(extents, i8))
      select case (kind)
      case (real_value)
        place%before = self%n_numbers
        self%n_numbers = self%n_numbers + place%size
      case (complex_value)
        place%before = self%n_numbers
        self%n_numbers = self%n_numbers + 2*place%size
      case (integer_value)
        place%before = self%n_integers
        self%n_integers = self%n_integers + place%size
      case default
        place%before = self%n_letters
        self%n_letters = self%n_letters + place%size
      end select
    end associate
  end subroutine declare

  !> Copy the numbers, such that they exist as long as the values.
  subroutine keep_numbers(self, numbers)
    class(named_values), intent(inout), target :: self
    real(wp), intent(in) :: numbers(:)
    self%own_numbers = numbers
    self%numbers => self%own_numbers
  end subroutine keep_numbers

  !> Address of the numbers in memory, which exist as long as the values; 0: there are none.
  integer(i8) function address(self)
    class(named_values), intent(in) :: self
    address = 0
    if (self%n_numbers > 0) address = transfer(c_loc(self%numbers), address)
  end function address

  !> All elements of a real value.
  function reals_at(self, place) result(values)
    class(named_values), intent(in), target :: self
    integer, intent(in) :: place
    real(wp), pointer, contiguous :: values(:)
    associate (at => self%places(place))
      values => self%numbers(at%before + 1:at%before + at%size)
    end associate
  end function reals_at

  !> All elements of a complex value.
  function complexes_at(self, place) result(values)
    class(named_values), intent(in), target :: self
    integer, intent(in) :: place
    complex(wp), pointer, contiguous :: values(:)
    associate (at => self%places(place))
      if (at%size > 0) then
        call c_f_pointer(c_loc(self%numbers(at%before + 1)), values, [at%size])
      else
        values => no_complexes
      end if
    end associate
  end function complexes_at

  subroutine put_real(self, name, value)
    class(named_values), intent(inout), target :: self
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: value
    call self%declare(name, real_value, [integer ::])
    call allocate_arrays(self)
    self%numbers(self%n_numbers) = value
  end subroutine put_real

  subroutine put_integer(self, name, value)
    class(named_values), intent(inout), target :: self
    character(len=*), intent(in) :: name
    integer(i8), intent(in) :: value
    call self%declare(name, integer_value, [integer ::])
    call allocate_arrays(self)
    self%integers(self%n_integers) = value
  end subroutine put_integer

  !> Store an array of any shape, given as a vector.
  subroutine put_reals(self, name, values, extents)
    class(named_values), intent(inout), target :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: extents(:)
    real(wp), intent(in) :: values(product(extents))
    call self%declare(name, real_value, extents)
    call allocate_arrays(self)
    self%numbers(self%n_numbers - size(values) + 1:self%n_numbers) = values
  end subroutine put_reals

  subroutine put_complexes(self, name, values, extents)
    class(named_values), intent(inout), target :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: extents(:)
    complex(wp), intent(in) :: values(product(extents))
    complex(wp), pointer, contiguous :: there(:)
    call self%declare(name, complex_value, extents)
    if (size(values) == 0) return
    call allocate_arrays(self)
    there => self%complexes_at(self%n)
    there = values
  end subroutine put_complexes

  !> Declare an array and return a pointer to fill it as a vector, which avoids a copy.
  function new_complexes(self, name, extents) result(there)
    class(named_values), intent(inout), target :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: extents(:)
    complex(wp), pointer, contiguous :: there(:)
    call self%declare(name, complex_value, extents)
    call allocate_arrays(self)
    there => self%complexes_at(self%n)
  end function new_complexes

  subroutine put_integers(self, name, values, extents)
    class(named_values), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: extents(:)
    integer, intent(in) :: values(product(extents))
    call self%put_longs(name, int(values, i8), extents)
  end subroutine put_integers

  subroutine put_longs(self, name, values, extents)
    class(named_values), intent(inout), target :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: extents(:)
    integer(i8), intent(in) :: values(product(extents))
    call self%declare(name, integer_value, extents)
    call allocate_arrays(self)
    self%integers(self%n_integers - size(values) + 1:self%n_integers) = values
  end subroutine put_longs

  subroutine put_text(self, name, text)
    class(named_values), intent(inout) :: self
    character(len=*), intent(in) :: name, text
    call self%declare(name, text_value, [len(text)])
    if (.not. allocated(self%letters)) self%letters = ''
    self%letters = self%letters//text
  end subroutine put_text

  !> Extend the arrays to all declared values, keeping their content.
  subroutine allocate_arrays(self)
    class(named_values), intent(inout), target :: self
    real(wp), allocatable :: numbers(:)
    integer(i8), allocatable :: integers(:)
    integer(i8) :: old

    old = 0
    if (allocated(self%own_numbers)) old = size(self%own_numbers, kind=i8)
    if (old < self%n_numbers .or. .not. associated(self%numbers)) then
      allocate (numbers(max(self%n_numbers, 2*old, 64_i8)))
      if (old > 0) numbers(:old) = self%own_numbers
      call move_alloc(numbers, self%own_numbers)
      self%numbers => self%own_numbers
    end if
    old = 0
    if (allocated(self%integers)) old = size(self%integers, kind=i8)
    if (old < self%n_integers) then
      allocate (integers(max(self%n_integers, 2*old, 16_i8)))
      if (old > 0) integers(:old) = self%integers
      call move_alloc(integers, self%integers)
    end if
  end subroutine allocate_arrays

end module viscovib_named_values
