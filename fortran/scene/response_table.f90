!> A response as a table: comma separated, a row a frequency.
module viscovib_response_table
  use viscovib_files, only: make_folder, remove_file, replace_file
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_names
  use viscovib_response, only: response_type
  use viscovib_status, only: fail, show, status_io_error, status_type
  implicit none
  private

  public :: write_response

  character(len=*), parameter :: coordinate_names(2) = [character(len=3) :: 'x', 'phi']

contains

  !> Write to a file beside it first and rename at the end, so that a table is
  !! there whole or not at all.
  subroutine write_response(folder, name, response, header, status)
    character(len=*), intent(in) :: folder, name
    type(response_type), intent(in) :: response
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: path
    character(len=200) :: message
    integer :: unit, io, i

    call make_folder(folder)
    path = folder//'/'//name
    message = ''
    open (newunit=unit, file=path//'.part', action='write', status='replace', iostat=io, &
          iomsg=message)
    if (io /= 0) then
      i = index(message, "': ", back=.true.)
      if (i > 0) message = message(i + 3:)
      call fail(status, status_io_error, 'out', path//': cannot be written ('//trim(message)//')')
      return
    end if
    call write_header(unit, header, response, io)
    do i = 1, size(response%nu)
      if (io /= 0) exit
      call write_row(unit, response, i, io)
    end do
    close (unit, iostat=i)
    if (io /= 0 .or. i /= 0) then
      call remove_file(path//'.part')
      call fail(status, status_io_error, 'out', path//': writing failed (disk full?)')
      return
    end if
    call replace_file(path//'.part', path, status)
  end subroutine write_response

  subroutine write_header(unit, header, response, io)
    integer, intent(in) :: unit
    character(len=*), intent(in) :: header
    type(response_type), intent(in) :: response
    integer, intent(out) :: io
    character(len=:), allocatable :: names, order
    integer :: first, last, d, k

    io = 0
    first = 1
    do while (first <= len(header) .and. io == 0)
      last = index(header(first:), new_line('a')) + first - 2
      if (last < first - 1) last = len(header)
      write (unit, '(2a)', iostat=io) '# ', header(first:last)
      first = last + 2
    end do
    if (io == 0) write (unit, '(a)', iostat=io) '# nu: circular frequency of the load (rad/s); ' &
      //'rate: factor between the last corrections; u = Im sum_k X_k exp(i k nu t),'
    if (io == 0) write (unit, '(a)', iostat=io) '# x_k_re, x_k_im: X_k of x (m); phi_k_re, ' &
      //'phi_k_im: X_k of phi (rad); nan where no solution was found'
    names = 'nu,outcome,iterations,rate'
    do d = 1, size(response%coefficients, 2)
      do k = 1, size(response%orders)
        order = trim(coordinate_names(d))//'_'//show(response%orders(k))
        names = names//','//order//'_re,'//order//'_im'
      end do
    end do
    if (io == 0) write (unit, '(a)', iostat=io) names
  end subroutine write_header

  subroutine write_row(unit, response, i, io)
    integer, intent(in) :: unit, i
    type(response_type), intent(in) :: response
    integer, intent(out) :: io
    character(len=:), allocatable :: row
    integer :: d, k

    row = number(response%nu(i))//','//trim(outcome_names(response%outcome(i)))//',' &
          //show(response%iterations(i))//','//number(response%rate(i))
    do d = 1, size(response%coefficients, 2)
      do k = 1, size(response%orders)
        row = row//','//number(real(response%coefficients(k, d, i))) &
              //','//number(aimag(response%coefficients(k, d, i)))
      end do
    end do
    write (unit, '(a)', iostat=io) row
  end subroutine write_row

  !> Seventeen digits, which read back to the same number; nan for none.
  pure function number(value)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: number
    character(len=24) :: buffer
    if (value /= value) then
      number = 'nan'
    else
      write (buffer, '(es24.16e3)') value
      number = trim(adjustl(buffer))
    end if
  end function number

end module viscovib_response_table
