!> The &multiple_scales group of a scene: steady motions of a pendulum along the frequency
!! or the amplitude of a load.
module viscovib_scales_job
  use viscovib_checks, only: check_positive
  use viscovib_files, only: make_folder
  use viscovib_grids, only: linear_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_form, only: new_pendulum_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_response, only: response_along, steady_points_type, vary_amplitude, &
    vary_frequency
  use viscovib_status, only: show, status_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: scales_job, read_scales, plan_scales, run_scales, write_scales, stable_points

  character(len=*), parameter :: parameter_names(6) = &
    [character(len=3) :: 'p1', 'p2', 'p3', 'f0', 'm01', 'm02']
  integer, parameter :: max_values = 1000000

  type :: scales_job
    !> Place in `parameter_names`.
    integer :: parameter = 1
    real(wp), allocatable :: values(:)
    real(wp) :: tolerance = 0.05_wp
  end type scales_job

contains

  subroutine read_scales(reader, job)
    type(group_reader), intent(inout) :: reader
    type(scales_job), intent(out) :: job
    type(status_type) :: status
    character(len=:), allocatable :: word
    real(wp) :: from, to
    integer :: n

    word = reader%read_text('parameter', 'p1', parameter_names, job%parameter)
    from = reader%read_real('from')
    to = reader%read_real('to')
    n = reader%read_integer('count', 201)
    job%tolerance = reader%read_real('tolerance', job%tolerance)
    allocate (job%values(0))
    if (reader%status%failed()) return
    if (job%parameter <= 3) then
      call check_positive('from', from, status)
      call reader%place(status)
    end if
    if (to <= from) call reader%complain('to', 'to = '//show(to)//': must be greater than from = ' &
                                         //show(from))
    if (n < 2 .or. n > max_values) call reader%complain('count', 'count = '//show(n) &
                                                        //': must be 2 to '//show(max_values))
    if (job%tolerance < 0.0_wp .or. job%tolerance >= 1.0_wp) then
      call reader%complain('tolerance', 'tolerance = '//show(job%tolerance)//': must be in [0, 1)')
    end if
    if (.not. reader%status%failed()) job%values = linear_grid(from, to, n)
  end subroutine read_scales

  function plan_scales(job) result(text)
    type(scales_job), intent(in) :: job
    character(len=:), allocatable :: text
    text = 'computes: steady motions to third order at '//show(size(job%values))//' values of ' &
           //trim(parameter_names(job%parameter))//' from '//show(job%values(1))//' to ' &
           //show(job%values(size(job%values)))//', with stability'//new_line('a')
  end function plan_scales

  subroutine run_scales(job, pendulum, points, status)
    type(scales_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(steady_points_type), intent(out) :: points
    type(status_type), intent(out) :: status
    type(polynomial_form_type) :: form
    integer :: cancel

    cancel = 0
    call new_pendulum_form(form, pendulum, status)
    if (status%failed()) return
    call response_along(form, modulo(job%parameter - 1, 3) + 1, &
                        merge(vary_frequency, vary_amplitude, job%parameter <= 3), job%values, &
                        job%tolerance, points, status, cancel)
  end subroutine run_scales

  !> No eigenvalue with a positive real part, but for rounding.
  pure function stable_points(points) result(stable)
    type(steady_points_type), intent(in) :: points
    logical :: stable(points%n)
    integer :: i
    do i = 1, points%n
      stable(i) = maxval(real(points%eigenvalues(:, i))) <= 1.0e-9_wp*maxval(points%frame(:, i))
    end do
  end function stable_points

  !> Write the table NAME in a folder, which is made if need be; the table is there whole or
  !! not at all.
  subroutine write_scales(folder, name, job, points, header, status)
    character(len=*), intent(in) :: folder, name
    type(scales_job), intent(in) :: job
    type(steady_points_type), intent(in) :: points
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    character(len=*), parameter :: coordinates(3) = [character(len=3) :: 'z', 'phi', 'psi']
    type(text_writer) :: table
    character(len=:), allocatable :: row
    logical :: stable(points%n)
    integer :: i, d

    stable = stable_points(points)
    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    call table%add_comments(header)
    call table%add_line('# steady motions by multiple scales to third order, dimensionless')
    call table%add_line('# first harmonic of u = Re X exp(i p t), p the frequency of the load; ' &
                        //'amplitudes of the modes; largest growth; sizes of the three orders')
    row = trim(parameter_names(job%parameter))//',stable'
    do d = 1, 3
      row = row//','//trim(coordinates(d))//'_re,'//trim(coordinates(d))//'_im'
    end do
    call table%add_line(row//',mode_1,mode_2,mode_3,growth,order_1,order_2,order_3')
    do i = 1, points%n
      row = trim(exact(job%values(points%value(i))))//','//show(merge(1, 0, stable(i)))
      do d = 1, 3
        row = row//','//trim(exact(real(points%harmonic(d, i))))//',' &
              //trim(exact(aimag(points%harmonic(d, i))))
      end do
      do d = 1, 3
        row = row//','//trim(exact(2.0_wp*abs(points%a(d, i))))
      end do
      row = row//','//trim(exact(maxval(real(points%eigenvalues(:, i)))))
      do d = 1, 3
        row = row//','//trim(exact(points%sizes(d, i)))
      end do
      call table%add_line(row)
    end do
    call table%finish(status)
  end subroutine write_scales

end module viscovib_scales_job
