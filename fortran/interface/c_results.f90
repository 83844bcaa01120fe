!> C interface: access to results. Indices start at 0, as in C.
module viscovib_c_results
  use, intrinsic :: iso_c_binding, only: c_associated, c_f_pointer, c_int, c_loc, c_null_ptr, c_ptr
  use viscovib_c_systems, only: text_of
  use viscovib_kept_result, only: kept_result, kept_table
  implicit none
  private

contains

  !> Result of a handle; not associated if there is none.
  function result_of(handle) result(found)
    type(c_ptr), intent(in) :: handle
    type(kept_result), pointer :: found
    nullify (found)
    if (c_associated(handle)) call c_f_pointer(handle, found)
  end function result_of

  !> Table of a result; not associated if there is none.
  function table_of(handle, table) result(found)
    type(c_ptr), intent(in) :: handle
    integer(c_int), intent(in) :: table
    type(kept_table), pointer :: found
    type(kept_result), pointer :: owner

    nullify (found)
    owner => result_of(handle)
    if (.not. associated(owner)) return
    if (table < 0 .or. table >= size(owner%tables)) return
    found => owner%tables(table + 1)
  end function table_of

  !> Like `table_of`, if the table has that column.
  function table_with(handle, table, column) result(found)
    type(c_ptr), intent(in) :: handle
    integer(c_int), intent(in) :: table, column
    type(kept_table), pointer :: found

    found => table_of(handle, table)
    if (.not. associated(found)) return
    if (column < 0 .or. column >= size(found%columns)) nullify (found)
  end function table_with

  type(c_ptr) function summary(handle) bind(c, name='viscovib_summary')
    type(c_ptr), value :: handle
    type(kept_result), pointer :: owner
    summary = c_null_ptr
    owner => result_of(handle)
    if (associated(owner)) summary = owner%summary%place()
  end function summary

  type(c_ptr) function warnings(handle) bind(c, name='viscovib_warnings')
    type(c_ptr), value :: handle
    type(kept_result), pointer :: owner
    warnings = c_null_ptr
    owner => result_of(handle)
    if (associated(owner)) warnings = owner%warnings%place()
  end function warnings

  integer(c_int) function complete(handle) bind(c, name='viscovib_complete')
    type(c_ptr), value :: handle
    type(kept_result), pointer :: owner
    complete = 0_c_int
    owner => result_of(handle)
    if (associated(owner)) complete = merge(1_c_int, 0_c_int, owner%complete)
  end function complete

  integer(c_int) function tables(handle) bind(c, name='viscovib_tables')
    type(c_ptr), value :: handle
    type(kept_result), pointer :: owner
    tables = 0_c_int
    owner => result_of(handle)
    if (associated(owner)) tables = size(owner%tables, kind=c_int)
  end function tables

  type(c_ptr) function table_name(handle, table) bind(c, name='viscovib_table_name')
    type(c_ptr), value :: handle
    integer(c_int), value :: table
    type(kept_table), pointer :: found
    table_name = c_null_ptr
    found => table_of(handle, table)
    if (associated(found)) table_name = found%name%place()
  end function table_name

  type(c_ptr) function table_notes(handle, table) bind(c, name='viscovib_table_notes')
    type(c_ptr), value :: handle
    integer(c_int), value :: table
    type(kept_table), pointer :: found
    table_notes = c_null_ptr
    found => table_of(handle, table)
    if (associated(found)) table_notes = found%notes%place()
  end function table_notes

  integer(c_int) function rows(handle, table) bind(c, name='viscovib_rows')
    type(c_ptr), value :: handle
    integer(c_int), value :: table
    type(kept_table), pointer :: found
    rows = 0_c_int
    found => table_of(handle, table)
    if (associated(found)) rows = size(found%values, 1, c_int)
  end function rows

  integer(c_int) function columns(handle, table) bind(c, name='viscovib_columns')
    type(c_ptr), value :: handle
    integer(c_int), value :: table
    type(kept_table), pointer :: found
    columns = 0_c_int
    found => table_of(handle, table)
    if (associated(found)) columns = size(found%columns, kind=c_int)
  end function columns

  type(c_ptr) function column_name(handle, table, column) bind(c, name='viscovib_column_name')
    type(c_ptr), value :: handle
    integer(c_int), value :: table, column
    type(kept_table), pointer :: found
    column_name = c_null_ptr
    found => table_with(handle, table, column)
    if (associated(found)) column_name = found%columns(column + 1)%place()
  end function column_name

  integer(c_int) function find_column(handle, table, name) bind(c, name='viscovib_find_column')
    type(c_ptr), value :: handle, name
    integer(c_int), value :: table
    type(kept_table), pointer :: found
    character(len=:), allocatable :: wanted
    integer :: j

    find_column = -1_c_int
    found => table_of(handle, table)
    if (.not. associated(found)) return
    wanted = text_of(name)
    do j = 1, size(found%columns)
      if (text_of(found%columns(j)%place()) /= wanted) cycle
      find_column = int(j - 1, c_int)
      return
    end do
  end function find_column

  type(c_ptr) function column_values(handle, table, column) bind(c, name='viscovib_column')
    type(c_ptr), value :: handle
    integer(c_int), value :: table, column
    type(kept_table), pointer :: found
    column_values = c_null_ptr
    found => table_with(handle, table, column)
    if (.not. associated(found)) return
    if (size(found%values, 1) > 0) column_values = c_loc(found%values(1, column + 1))
  end function column_values

  type(c_ptr) function word(handle, table, column, row) bind(c, name='viscovib_word')
    type(c_ptr), value :: handle
    integer(c_int), value :: table, column, row
    type(kept_table), pointer :: found
    integer :: code

    word = c_null_ptr
    found => table_with(handle, table, column)
    if (.not. associated(found)) return
    if (row < 0 .or. row >= size(found%values, 1)) return
    if (found%n_words(column + 1) == 0) return
    code = nint(found%values(row + 1, column + 1))
    if (code < 0 .or. code >= found%n_words(column + 1)) return
    word = found%words(code + 1, column + 1)%place()
  end function word

  subroutine result_free(handle) bind(c, name='viscovib_result_free')
    type(c_ptr), value :: handle
    type(kept_result), pointer :: owner
    owner => result_of(handle)
    if (associated(owner)) deallocate (owner)
  end subroutine result_free

end module viscovib_c_results
