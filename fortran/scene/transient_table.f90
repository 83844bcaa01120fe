!> A motion in time as a table: comma separated, a row a time.
module viscovib_transient_table
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_files, only: make_folder
  use viscovib_number_text, only: exact
  use viscovib_simulate, only: run_names
  use viscovib_status, only: status_type
  use viscovib_text_file, only: text_writer
  use viscovib_transient_job, only: trajectory_type
  implicit none
  private

  public :: write_transient

contains

  !> Write the table NAME in a folder, which is made if need be; the table is
  !! there whole or not at all.
  subroutine write_transient(folder, name, trajectory, method, coordinates, units, header, status)
    character(len=*), intent(in) :: folder, name
    type(trajectory_type), intent(in) :: trajectory
    character(len=*), intent(in) :: method
    !> Names, and a line about units.
    character(len=*), intent(in) :: coordinates(:), units
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(text_writer) :: table
    character(len=:), allocatable :: row
    integer :: i, j

    if (counting) call count_up(counted_columns, size(coordinates))
    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    call table%add_comments(header)
    call table%add_line('# method '//method//', step ' &
                        //trim(exact(trajectory%h))//', '//trim(run_names(trajectory%outcome)))
    call table%add_line('# '//units)
    row = 't'
    do j = 1, size(coordinates)
      row = row//','//trim(coordinates(j))//','//trim(coordinates(j))//'_dot'
    end do
    call table%add_line(row)
    do i = 1, size(trajectory%t)
      row = trim(exact(trajectory%t(i)))
      do j = 1, size(trajectory%states, 1)
        row = row//','//trim(exact(trajectory%states(j, i)))
      end do
      call table%add_line(row)
    end do
    call table%finish(status)
  end subroutine write_transient

end module viscovib_transient_table
