!> A result as a table: notes, followed by named columns of comma-separated values.
module viscovib_table
  use viscovib_files, only: make_folder
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_status, only: show, status_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: table_type, listed, listed_units

  character(len=*), parameter :: nl = new_line('a')
  !> Length of a cell with a number.
  integer, parameter :: width = 24

  !> A column points to its values, which must outlive it, or contains a copy.
  type :: column_type
    character(len=:), allocatable :: name
    real(wp), pointer :: reals(:) => null()
    integer, pointer :: integers(:) => null()
    real(wp), allocatable :: held(:)
    integer, allocatable :: codes(:)
    !> Words for the integer codes; not allocated: the integers are numbers.
    character(len=:), allocatable :: words(:)
  end type column_type

  type :: table_type
    private
    character(len=:), allocatable :: notes
    type(column_type), allocatable :: columns(:)
    integer :: n = 0
  contains
    procedure :: note
    !> Point to values that outlive the table.
    procedure :: add_reals
    procedure :: add_complex
    procedure :: add_integers
    procedure :: add_words
    !> Copy the values.
    procedure :: hold_reals
    procedure :: hold_integers
    procedure :: write => write_table
    !> Access to the content, for callers that write no file.
    procedure :: n_columns
    procedure :: n_rows
    procedure :: name
    procedure :: all_notes
    procedure :: numbers
    procedure :: is_whole
    procedure :: n_words
    procedure :: word
    procedure, private :: grow
  end type table_type

contains

  !> Add a line above the columns.
  subroutine note(self, line)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: line
    if (.not. allocated(self%notes)) self%notes = ''
    self%notes = self%notes//line//nl
  end subroutine note

  subroutine add_reals(self, name, values)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(in), target :: values(:)
    call self%grow(name)
    self%columns(self%n)%reals => values
  end subroutine add_reals

  subroutine hold_reals(self, name, values)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)
    call self%grow(name)
    allocate (self%columns(self%n)%held, source=values)
  end subroutine hold_reals

  subroutine hold_integers(self, name, values)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: values(:)
    call self%grow(name)
    allocate (self%columns(self%n)%codes, source=values)
  end subroutine hold_integers

  !> Two columns, NAME_re and NAME_im.
  subroutine add_complex(self, name, values)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    complex(wp), intent(in), target :: values(:)
    call self%grow(name//'_re')
    self%columns(self%n)%reals => values%re
    call self%grow(name//'_im')
    self%columns(self%n)%reals => values%im
  end subroutine add_complex

  subroutine add_integers(self, name, values)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in), target :: values(:)
    call self%grow(name)
    self%columns(self%n)%integers => values
  end subroutine add_integers

  !> Add a column of integer codes, written as words.
  subroutine add_words(self, name, codes, words)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in), target :: codes(:)
    !> Words for the codes 0, 1, ...
    character(len=*), intent(in) :: words(0:)
    call self%add_integers(name, codes)
    allocate (self%columns(self%n)%words, source=words)
  end subroutine add_words

  subroutine grow(self, name)
    class(table_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    type(column_type), allocatable :: wider(:)
    integer :: i

    if (.not. allocated(self%columns)) then
      allocate (self%columns(16))
    else if (self%n == size(self%columns)) then
      allocate (wider(2*self%n))
      do i = 1, self%n
        call move_alloc(self%columns(i)%name, wider(i)%name)
        wider(i)%reals => self%columns(i)%reals
        wider(i)%integers => self%columns(i)%integers
        call move_alloc(self%columns(i)%held, wider(i)%held)
        call move_alloc(self%columns(i)%codes, wider(i)%codes)
        if (allocated(self%columns(i)%words)) then
          call move_alloc(self%columns(i)%words, wider(i)%words)
        end if
      end do
      call move_alloc(wider, self%columns)
    end if
    self%n = self%n + 1
    self%columns(self%n)%name = name
  end subroutine grow

  pure integer function n_columns(self)
    class(table_type), intent(in) :: self
    n_columns = self%n
  end function n_columns

  pure integer function n_rows(self)
    class(table_type), intent(in) :: self
    n_rows = 0
    if (self%n == 0) return
    associate (column => self%columns(self%n))
      if (associated(column%reals)) n_rows = size(column%reals)
      if (associated(column%integers)) n_rows = size(column%integers)
      if (allocated(column%held)) n_rows = size(column%held)
      if (allocated(column%codes)) n_rows = size(column%codes)
    end associate
  end function n_rows

  !> Name of column j, from 1.
  pure function name(self, j)
    class(table_type), intent(in) :: self
    integer, intent(in) :: j
    character(len=:), allocatable :: name
    name = self%columns(j)%name
  end function name

  !> The lines above the columns, each ended by a new-line character.
  pure function all_notes(self) result(text)
    class(table_type), intent(in) :: self
    character(len=:), allocatable :: text
    text = ''
    if (allocated(self%notes)) text = self%notes
  end function all_notes

  !> Values of column j as reals, also if they are integers.
  pure function numbers(self, j) result(values)
    class(table_type), intent(in) :: self
    integer, intent(in) :: j
    real(wp), allocatable :: values(:)
    associate (column => self%columns(j))
      if (associated(column%reals)) then
        values = column%reals
      else if (allocated(column%held)) then
        values = column%held
      else if (allocated(column%codes)) then
        values = column%codes
      else
        values = column%integers
      end if
    end associate
  end function numbers

  !> True if the values of column j are integers.
  pure logical function is_whole(self, j)
    class(table_type), intent(in) :: self
    integer, intent(in) :: j
    is_whole = associated(self%columns(j)%integers) .or. allocated(self%columns(j)%codes)
  end function is_whole

  !> Number of words of column j, for codes 0, 1, ...; 0: the column has numbers.
  pure integer function n_words(self, j)
    class(table_type), intent(in) :: self
    integer, intent(in) :: j
    n_words = 0
    if (allocated(self%columns(j)%words)) n_words = size(self%columns(j)%words)
  end function n_words

  !> Word of `code` in column j.
  pure function word(self, j, code)
    class(table_type), intent(in) :: self
    integer, intent(in) :: j, code
    character(len=:), allocatable :: word
    word = trim(self%columns(j)%words(code))
  end function word

  !> Write the table as the file NAME into a folder, which is created if necessary. The file is
  !! complete or does not exist.
  subroutine write_table(self, folder, name, header, status)
    class(table_type), intent(in) :: self
    character(len=*), intent(in) :: folder, name
    !> Lines above the notes, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(text_writer) :: file
    character(len=:), allocatable :: row
    integer :: i, j, length, at

    call make_folder(folder)
    call file%create(folder//'/'//name, status)
    if (status%failed()) return
    call file%add_comments(header)
    if (allocated(self%notes)) call file%add_comments(self%notes)
    length = 0
    do j = 1, self%n
      associate (column => self%columns(j))
        length = length + max(width, len(quoted(column%name))) + 1
        if (allocated(column%words)) length = length + len(column%words)
      end associate
    end do
    allocate (character(len=length) :: row)
    at = 0
    do j = 1, self%n
      if (j > 1) call append(',')
      call append(quoted(self%columns(j)%name))
    end do
    call file%add_line(row(:at))
    do i = 1, self%n_rows()
      at = 0
      do j = 1, self%n
        if (j > 1) call append(',')
        associate (column => self%columns(j))
          if (associated(column%reals)) then
            call append(trim(exact(column%reals(i))))
          else if (allocated(column%held)) then
            call append(trim(exact(column%held(i))))
          else if (allocated(column%codes)) then
            call append(show(column%codes(i)))
          else if (allocated(column%words)) then
            call append(trim(column%words(column%integers(i))))
          else
            call append(show(column%integers(i)))
          end if
        end associate
      end do
      call file%add_line(row(:at))
    end do
    call file%finish(status)

  contains

    subroutine append(cell)
      character(len=*), intent(in) :: cell
      row(at + 1:at + len(cell)) = cell
      at = at + len(cell)
    end subroutine append
  end subroutine write_table

  !> A name as a CSV cell: in quotes if it contains a comma or a quote; quotes are doubled.
  pure function quoted(name)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: quoted
    integer :: i
    if (scan(name, ',"') == 0) then
      quoted = name
      return
    end if
    quoted = '"'
    do i = 1, len(name)
      if (name(i:i) == '"') quoted = quoted//'"'
      quoted = quoted//name(i:i)
    end do
    quoted = quoted//'"'
  end function quoted

  !> Numbers in a line, each after a space.
  pure function listed(values)
    real(wp), intent(in) :: values(:)
    character(len=:), allocatable :: listed
    integer :: i
    listed = ''
    do i = 1, size(values)
      listed = listed//' '//trim(exact(values(i)))
    end do
  end function listed

  !> "x in m, phi in rad".
  pure function listed_units(names, units) result(text)
    character(len=*), intent(in) :: names(:), units(:)
    character(len=:), allocatable :: text
    integer :: i
    text = ''
    do i = 1, size(names)
      if (i > 1) text = text//', '
      text = text//trim(names(i))//' in '//trim(units(i))
    end do
  end function listed_units

end module viscovib_table
