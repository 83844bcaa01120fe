!> Spectra of a motion as a table: comma separated, a row a frequency.
module viscovib_spectrum_table
  use viscovib_amplitude_spectrum, only: amplitude_spectrum
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_files, only: make_folder
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_status, only: status_type
  use viscovib_text_file, only: text_writer
  use viscovib_windows, only: window_names
  implicit none
  private

  public :: write_spectrum

contains

  !> Transform the coordinates and write the table NAME in a folder, which is made
  !! if need be; the table is there whole or not at all.
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
    type(text_writer) :: table
    complex(wp), allocatable :: spectra(:, :)
    character(len=:), allocatable :: row
    integer :: j, k, n

    n = size(coordinates, 1)
    allocate (spectra(0:n/2, size(names)))
    row = 'omega'
    do j = 1, size(names)
      call amplitude_spectrum(coordinates(:, j), window, spectra(:, j))
      row = row//','//trim(names(j))//'_amplitude,'//trim(names(j))//'_phase'
    end do
    if (counting) call count_up(counted_columns, size(names))
    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    call table%add_comments(header)
    call table%add_line('# window '//trim(window_names(window))//'; omega in rad per unit of ' &
                        //'time, phases in rad at the first sample')
    call table%add_line(row)
    do k = 0, n/2
      row = trim(exact(2.0_wp*pi/(n*step)*k))
      do j = 1, size(names)
        row = row//','//trim(exact(abs(spectra(k, j))))//',' &
              //trim(exact(atan2(aimag(spectra(k, j)), real(spectra(k, j)))))
      end do
      call table%add_line(row)
    end do
    call table%finish(status)
  end subroutine write_spectrum

end module viscovib_spectrum_table
