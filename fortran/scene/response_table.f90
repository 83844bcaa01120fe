!> A response as a table: comma separated, a row a frequency.
module viscovib_response_table
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_files, only: make_folder
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_outcomes, only: outcome_names
  use viscovib_response, only: response_type
  use viscovib_status, only: show, status_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: write_response

contains

  !> Write the table NAME in a folder, which is made if need be; the table is
  !! there whole or not at all.
  subroutine write_response(folder, name, response, coordinates, units, header, status)
    character(len=*), intent(in) :: folder, name
    type(response_type), intent(in) :: response
    !> Names and units, one a coordinate.
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(text_writer) :: table
    integer :: i

    if (counting) call count_up(counted_columns, size(coordinates))
    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    call write_header(table, header, coordinates, units, response)
    do i = 1, size(response%nu)
      call write_row(table, response, i)
    end do
    call table%finish(status)
  end subroutine write_response

  subroutine write_header(table, header, coordinates, units, response)
    type(text_writer), intent(inout) :: table
    character(len=*), intent(in) :: header, coordinates(:), units(:)
    type(response_type), intent(in) :: response
    character(len=:), allocatable :: names, order
    integer :: d, k

    call table%add_comments(header)
    call table%add_line('# nu: circular frequency of the load (rad/s); rate: factor between the ' &
                        //'last corrections; highest: order kept; truncation: estimated relative ' &
                        //'error of leaving out higher orders; ' &
                        //'u = Im sum_k X_k exp(i k nu t),')
    if (allocated(response%stability%stable)) then
      call table%add_line('# stable: 1: stable, 0: not, -1: unknown')
    end if
    names = '# '
    do d = 1, size(coordinates)
      order = trim(coordinates(d))
      names = names//order//'_k_re, '//order//'_k_im: X_k of '//order//' ('//trim(units(d))//'); '
    end do
    call table%add_line(names//'nan where no solution was found')
    names = 'nu,outcome,iterations,rate,highest,truncation'
    if (allocated(response%stability%stable)) names = names//',stable'
    do d = 1, size(response%coefficients, 2)
      do k = 1, size(response%orders)
        order = trim(coordinates(d))//'_'//show(response%orders(k))
        names = names//','//order//'_re,'//order//'_im'
      end do
    end do
    call table%add_line(names)
  end subroutine write_header

  subroutine write_row(table, response, i)
    type(text_writer), intent(inout) :: table
    type(response_type), intent(in) :: response
    integer, intent(in) :: i
    character(len=:), allocatable :: row
    integer :: d, k

    row = number(response%nu(i))//','//trim(outcome_names(response%outcome(i)))//',' &
          //show(response%iterations(i))//','//number(response%rate(i))//',' &
          //show(response%highest(i))//','//number(response%truncation(i))
    if (allocated(response%stability%stable)) row = row//','//show(response%stability%stable(i))
    do d = 1, size(response%coefficients, 2)
      do k = 1, size(response%orders)
        row = row//','//number(real(response%coefficients(k, d, i))) &
              //','//number(aimag(response%coefficients(k, d, i)))
      end do
    end do
    call table%add_line(row)
  end subroutine write_row

  !> Seventeen digits, which read back to the same number; nan for none.
  pure function number(value)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: number
    number = 'nan'
    if (value == value) number = trim(exact(value))
  end function number

end module viscovib_response_table
