!> A motion in time as a table, a row a time.
module viscovib_transient_table
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_number_text, only: exact
  use viscovib_simulate, only: run_names
  use viscovib_status, only: status_type
  use viscovib_table, only: table_type
  use viscovib_transient_job, only: trajectory_type
  implicit none
  private

  public :: write_transient

contains

  !> Write the table NAME in a folder.
  subroutine write_transient(folder, name, trajectory, method, coordinates, units, header, status)
    character(len=*), intent(in) :: folder, name
    type(trajectory_type), intent(in), target :: trajectory
    character(len=*), intent(in) :: method
    !> Names, and a line about units.
    character(len=*), intent(in) :: coordinates(:), units
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(table_type) :: table
    integer :: j

    if (counting) call count_up(counted_columns, size(coordinates))
    call table%note('method '//method//', step '//trim(exact(trajectory%h))//', ' &
                    //trim(run_names(trajectory%outcome)))
    call table%note(units)
    call table%add_reals('t', trajectory%t)
    do j = 1, size(coordinates)
      call table%add_reals(trim(coordinates(j)), trajectory%states(2*j - 1, :))
      call table%add_reals(trim(coordinates(j))//'_dot', trajectory%states(2*j, :))
    end do
    call table%write(folder, name, header, status)
  end subroutine write_transient

end module viscovib_transient_table
