!> Results in memory for C: null-terminated texts, columns of doubles.
module viscovib_kept_result
  use, intrinsic :: iso_c_binding, only: c_char, c_double, c_loc, c_null_char, c_null_ptr, c_ptr
  use viscovib_job, only: table_sink
  use viscovib_status, only: set_ok, status_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: c_text, kept_result, kept_table, new_text

  type :: c_text
    character(kind=c_char), allocatable :: letters(:)
  contains
    procedure :: place
  end type c_text

  type :: kept_table
    type(c_text) :: name, notes
    type(c_text), allocatable :: columns(:)
    !> Shape (rows, columns).
    real(c_double), allocatable :: values(:, :)
    !> Words of each column, from code 0, shape (most words, columns), empty where missing; and the
    !! number of words of each column.
    type(c_text), allocatable :: words(:, :)
    integer, allocatable :: n_words(:)
  end type kept_table

  type, extends(table_sink) :: kept_result
    type(kept_table), allocatable :: tables(:)
    type(c_text) :: summary, warnings
    logical :: complete = .true.
  contains
    procedure :: put
  end type kept_result

contains

  !> Convert a text to a C string.
  pure function new_text(text) result(made)
    character(len=*), intent(in) :: text
    type(c_text) :: made
    integer :: i
    allocate (made%letters(len(text) + 1))
    do i = 1, len(text)
      made%letters(i) = text(i:i)
    end do
    made%letters(len(text) + 1) = c_null_char
  end function new_text

  !> Address of the text.
  function place(self)
    class(c_text), intent(in), target :: self
    type(c_ptr) :: place
    place = c_null_ptr
    if (allocated(self%letters)) place = c_loc(self%letters)
  end function place

  !> Copy a table, whose values exist only as long as the job.
  subroutine put(self, name, table, status)
    class(kept_result), intent(inout) :: self
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    type(status_type), intent(out) :: status
    type(kept_table), allocatable :: more(:)
    integer :: i, j, n

    call set_ok(status)
    if (.not. allocated(self%tables)) allocate (self%tables(0))
    allocate (more(size(self%tables) + 1))
    do i = 1, size(self%tables)
      call move_table(self%tables(i), more(i))
    end do
    call move_alloc(more, self%tables)
    associate (kept => self%tables(size(self%tables)))
      n = table%n_columns()
      kept%name = new_text(name)
      kept%notes = new_text(table%all_notes())
      allocate (kept%columns(n), kept%values(table%n_rows(), n), kept%n_words(n))
      do j = 1, n
        kept%columns(j) = new_text(table%name(j))
        kept%values(:, j) = table%numbers(j)
        kept%n_words(j) = table%n_words(j)
      end do
      allocate (kept%words(maxval([0, kept%n_words]), n))
      do j = 1, n
        do i = 1, kept%n_words(j)
          kept%words(i, j) = new_text(table%word(j, i - 1))
        end do
      end do
    end associate
  end subroutine put

  pure subroutine move_table(from, to)
    type(kept_table), intent(inout) :: from, to
    call move_alloc(from%name%letters, to%name%letters)
    call move_alloc(from%notes%letters, to%notes%letters)
    call move_alloc(from%columns, to%columns)
    call move_alloc(from%values, to%values)
    call move_alloc(from%words, to%words)
    call move_alloc(from%n_words, to%n_words)
  end subroutine move_table

end module viscovib_kept_result
