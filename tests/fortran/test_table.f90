!> Tables: written completely or not at all.
module test_table
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use test_scene_files, only: read_scratch, remove_scratch, scratch, write_scratch
  use testing, only: begin, check, check_fails, check_ok
  use viscovib_files, only: make_folder, remove_file
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_diverged
  use viscovib_response, only: response_type
  use viscovib_response_job, only: tabulate_response
  use viscovib_status, only: status_io_error, status_type
  use viscovib_table, only: table_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: run_table

  character(len=*), parameter :: nl = new_line('a')

contains

  subroutine run_table()
    type(response_type), target :: response
    type(table_type) :: table
    type(status_type) :: status
    type(text_writer) :: file
    character(len=:), allocatable :: text

    call response%allocate_for([0.1_wp, 2.0_wp], [1, 3], 2, 0)
    response%method = [2, 3]
    response%coefficients(2, 1, 1) = (1.0_wp, -0.3_wp)
    call response%discard(2, outcome_diverged)
    call tabulate_response(response, ['x  ', 'phi'], ['m  ', 'rad'], table, &
                           [1.0e-15_wp, ieee_value(1.0_wp, ieee_quiet_nan)])

    if (begin('a table, its folder made')) then
      call table%write(scratch('table/a'), 't.csv', 'first'//nl//'second', status)
      call check_ok(status)
      text = read_scratch('table/a/t.csv')
      call check(index(text, '# first'//nl//'# second'//nl//'# nu: ') == 1, 'header')
      call check(index(text, nl//'nu,outcome,method,iterations,rate,highest,truncation,error,' &
                       //'x_1_re,x_1_im,x_3_re,x_3_im,phi_1_re,') > 0, 'columns')
      call check(index(text, nl//'1.0000000000000001e-01,converged,successive,0,') > 0, 'digits')
      call check(index(text, ',1.0000000000000000e+00,-2.9999999999999999e-01,') > 0, 'values')
      call check(index(text, nl//'2.0000000000000000e+00,diverged,newton,0,' &
                       //'0.0000000000000000e+00,0'//repeat(',nan', 10)//nl) > 0, &
                 'no solution is nan')
      call check(read_scratch('table/a/t.csv.part') == '(none)', 'nothing left next to it')
    end if

    if (begin('a table replaces an older one')) then
      call write_scratch('table_old.csv', repeat('old ', 10000))
      call table%write('.', scratch('table_old.csv'), 'new', status)
      call check_ok(status)
      call check(index(read_scratch('table_old.csv'), 'old') == 0, 'nothing of the old one')
      call remove_scratch('table_old.csv')
    end if

    if (begin('no table where there is a folder or no way')) then
      call make_folder(scratch('table/b.csv'))
      call table%write(scratch('table'), 'b.csv', 'x', status)
      call check_fails(status, scratch('table/b.csv') &
                       //': cannot be written (not a regular file)')
      call check(status%category == status_io_error, 'an i/o error')
      call check(read_scratch('table/b.csv.part') == '(none)', 'nothing left')
      call remove_file(scratch('table/b.csv'))
      call write_scratch('table_file', '')
      call table%write(scratch('table_file/c'), 't.csv', 'x', status)
      call check_fails(status, scratch('table_file/c/t.csv')//': cannot be written (')
      call check(status%category == status_io_error, 'an i/o error')
      call remove_scratch('table_file')
    end if

    if (begin('a writer that was not opened writes nothing')) then
      call file%create(scratch('table/none/t.txt'), status)
      call check_fails(status, 'cannot be written (No such file or directory)')
      call file%add_line('a line')
      call file%finish(status)
      call check_ok(status)
      call check(read_scratch('table/none/t.txt') == '(none)', 'no file')
    end if

    call remove_scratch('table/a/t.csv')
    call remove_file(scratch('table/a'))
    call remove_file(scratch('table'))
  end subroutine run_table

end module test_table
