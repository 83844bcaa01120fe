!> A response as a table, a row a frequency.
module viscovib_response_table
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_outcomes, only: outcome_names
  use viscovib_response, only: response_type
  use viscovib_status, only: show, status_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: write_response

contains

  !> Write the table NAME in a folder.
  subroutine write_response(folder, name, response, coordinates, units, header, status)
    character(len=*), intent(in) :: folder, name
    type(response_type), intent(in), target :: response
    !> Names and units, one a coordinate.
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: names
    integer :: d, k

    if (counting) call count_up(counted_columns, size(coordinates))
    call table%note('nu: circular frequency of the load (rad/s); rate: factor between the last ' &
                    //'corrections; highest: order kept; truncation: estimated relative error ' &
                    //'of leaving out higher orders; u = Im sum_k X_k exp(i k nu t),')
    names = ''
    do d = 1, size(coordinates)
      names = names//trim(coordinates(d))//'_k_re, '//trim(coordinates(d))//'_k_im: X_k of ' &
              //trim(coordinates(d))//' ('//trim(units(d))//'); '
    end do
    call table%note(names//'nan where no solution was found')
    call table%add_reals('nu', response%nu)
    call table%add_words('outcome', response%outcome, outcome_names)
    call table%add_integers('iterations', response%iterations)
    call table%add_reals('rate', response%rate)
    call table%add_integers('highest', response%highest)
    call table%add_reals('truncation', response%truncation)
    if (allocated(response%stability%stable)) then
      call table%note('stable: 1: stable, 0: not, -1: unknown')
      call table%add_integers('stable', response%stability%stable)
    end if
    do d = 1, size(response%coefficients, 2)
      do k = 1, size(response%orders)
        call table%add_complex(trim(coordinates(d))//'_'//show(response%orders(k)), &
                               response%coefficients(k, d, :))
      end do
    end do
    call table%write(folder, name, header, status)
  end subroutine write_response

end module viscovib_response_table
