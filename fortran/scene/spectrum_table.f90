!> Spectra of a motion as a table, a row a frequency.
module viscovib_spectrum_table
  use viscovib_amplitude_spectrum, only: amplitude_spectrum
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_kinds, only: wp
  use viscovib_polar, only: argument, modulus
  use viscovib_status, only: status_type
  use viscovib_table, only: table_type
  use viscovib_windows, only: window_names
  implicit none
  private

  public :: write_spectrum

contains

  !> Transform the coordinates and write the table NAME in a folder.
  subroutine write_spectrum(folder, name, coordinates, names, step, window, header, status)
    character(len=*), intent(in) :: folder, name
    !> Samples, shape (n, m), m names.
    real(wp), intent(in) :: coordinates(:, :)
    character(len=*), intent(in) :: names(:)
    real(wp), intent(in) :: step
    !> Place in `window_names`.
    integer, intent(in) :: window
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(table_type) :: table
    complex(wp), allocatable :: spectrum(:)
    integer :: j, k, n

    if (counting) call count_up(counted_columns, size(names))
    n = size(coordinates, 1)
    allocate (spectrum(0:n/2))
    call table%note('window '//trim(window_names(window))//'; omega in rad per unit of time, ' &
                    //'phases in rad at the first sample')
    call table%hold_reals('omega', [(2.0_wp*pi/(n*step)*k, k=0, n/2)])
    do j = 1, size(names)
      call amplitude_spectrum(coordinates(:, j), window, spectrum)
      call table%hold_reals(trim(names(j))//'_amplitude', modulus(spectrum))
      call table%hold_reals(trim(names(j))//'_phase', argument(spectrum))
    end do
    call table%write(folder, name, header, status)
  end subroutine write_spectrum

end module viscovib_spectrum_table
