!> The &multiple_scales group of a scene: steady motions along the frequency or the amplitude
!! of a load, of a pendulum, a mount or a polynomial system.
module viscovib_scales_job
  use viscovib_checks, only: check_positive
  use viscovib_grids, only: linear_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_normal_form, only: by_influence
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_form, only: new_pendulum_form, ordering_names
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_response, only: response_along, steady_points_type, vary_amplitude, &
    vary_frequency
  use viscovib_status, only: show, status_type
  use viscovib_system_form, only: new_oscillator_form
  use viscovib_table, only: table_type
  implicit none
  private

  public :: scales_job, read_pendulum_scales, read_oscillator_scales, plan_scales, &
            run_pendulum_scales, run_oscillator_scales, write_scales, stable_points

  character(len=*), parameter :: pendulum_names(6) = &
    [character(len=3) :: 'p1', 'p2', 'p3', 'f0', 'm01', 'm02']
  character(len=*), parameter :: oscillator_names(2) = [character(len=4) :: 'nu', 'load']
  integer, parameter :: max_values = 1000000

  type :: scales_job
    !> What is varied: its name, which load, frequency or amplitude.
    character(len=4) :: parameter = 'p1'
    integer :: load = 1, vary = vary_frequency
    real(wp), allocatable :: values(:)
    real(wp) :: tolerance = by_influence
    !> Place in `ordering_names`, of a pendulum.
    integer :: ordering = 1
    !> Load and its frequency, of the others; load times cos(nu t).
    real(wp), allocatable :: force(:)
    real(wp) :: nu = 1.0_wp
  end type scales_job

contains

  subroutine read_pendulum_scales(reader, job)
    type(group_reader), intent(inout) :: reader
    type(scales_job), intent(out) :: job
    character(len=:), allocatable :: word
    integer :: which

    which = 1
    job%parameter = reader%read_text('parameter', 'p1', pendulum_names, which)
    job%load = modulo(which - 1, 3) + 1
    job%vary = merge(vary_frequency, vary_amplitude, which <= 3)
    call read_values(reader, job)
    word = reader%read_text('ordering', trim(ordering_names(1)), ordering_names, job%ordering)
  end subroutine read_pendulum_scales

  !> The load is the scene's: one frequency, one phase.
  subroutine read_oscillator_scales(reader, load, job)
    type(group_reader), intent(inout) :: reader
    type(load_type), intent(in) :: load
    type(scales_job), intent(out) :: job
    type(status_type) :: status
    integer :: which

    which = 1
    job%parameter = reader%read_text('parameter', 'nu', oscillator_names, which)
    job%vary = merge(vary_frequency, vary_amplitude, which == 1)
    call read_values(reader, job)
    if (job%vary == vary_amplitude) then
      job%nu = reader%read_real('nu')
      call check_positive('nu', job%nu, status)
      call reader%place(status)
    else
      call reader%refuse(['nu'], 'the frequency is what is varied')
    end if
    if (load%moves_base()) call reader%complain('parameter', "&load kind = 'base': is for " &
                                                //'&response; must be a force for &multiple_scales')
    if (any(load%orders /= 1) .or. size(load%orders) == 0) then
      call reader%complain('parameter', '&load: must have order 1 alone, and not vanish, for ' &
                           //'&multiple_scales')
    end if
    if (reader%status%failed()) return
    if (any(abs(aimag(load%force)) > 0.0_wp)) then
      call reader%complain('parameter', '&load: must have phase 0 for &multiple_scales; phases ' &
                           //'of the motion are counted from the load')
      return
    end if
    job%force = real(load%force(:, 1))
  end subroutine read_oscillator_scales

  subroutine read_values(reader, job)
    type(group_reader), intent(inout) :: reader
    type(scales_job), intent(inout) :: job
    type(status_type) :: status
    real(wp) :: from, to
    integer :: n

    from = reader%read_real('from')
    to = reader%read_real('to')
    n = reader%read_integer('count', 201)
    job%tolerance = reader%read_real('tolerance', job%tolerance)
    allocate (job%values(0))
    if (reader%status%failed()) return
    if (job%vary == vary_frequency) then
      call check_positive('from', from, status)
      call reader%place(status)
    end if
    if (to <= from) call reader%complain('to', 'to = '//show(to)//': must be greater than from = ' &
                                         //show(from))
    if (n < 2 .or. n > max_values) call reader%complain('count', 'count = '//show(n) &
                                                        //': must be 2 to '//show(max_values))
    if ((job%tolerance < 0.0_wp .and. job%tolerance > by_influence) &
        .or. job%tolerance >= 1.0_wp) then
      call reader%complain('tolerance', 'tolerance = '//show(job%tolerance)//': must be in [0, 1)')
    end if
    if (.not. reader%status%failed()) job%values = linear_grid(from, to, n)
  end subroutine read_values

  function plan_scales(job) result(text)
    type(scales_job), intent(in) :: job
    character(len=:), allocatable :: text
    text = 'computes: steady motions to third order at '//show(size(job%values))//' values of ' &
           //trim(job%parameter)//' from '//show(job%values(1))//' to ' &
           //show(job%values(size(job%values)))//', with stability and errors'//new_line('a')
    if (job%ordering > 1) text = text//'skips: degrees above the third, e counted as one (' &
                                 //trim(ordering_names(job%ordering))//')'//new_line('a')
  end function plan_scales

  subroutine run_pendulum_scales(job, pendulum, points, status)
    type(scales_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(steady_points_type), intent(out) :: points
    type(status_type), intent(out) :: status
    type(polynomial_form_type) :: form

    call new_pendulum_form(form, pendulum, job%ordering, status)
    if (.not. status%failed()) call run_form(job, form, points, status)
  end subroutine run_pendulum_scales

  subroutine run_oscillator_scales(job, oscillator, points, status)
    type(scales_job), intent(in) :: job
    class(oscillator_type), intent(in) :: oscillator
    type(steady_points_type), intent(out) :: points
    type(status_type), intent(out) :: status
    type(polynomial_form_type) :: form

    call new_oscillator_form(form, oscillator, job%force, job%nu, status)
    if (.not. status%failed()) call run_form(job, form, points, status)
  end subroutine run_oscillator_scales

  subroutine run_form(job, form, points, status)
    type(scales_job), intent(in) :: job
    type(polynomial_form_type), intent(in) :: form
    type(steady_points_type), intent(out) :: points
    type(status_type), intent(out) :: status
    integer :: cancel

    cancel = 0
    call response_along(form, job%load, job%vary, job%values, job%tolerance, .true., points, &
                        status, cancel)
  end subroutine run_form

  !> No eigenvalue with a positive real part, but for rounding.
  pure function stable_points(points) result(stable)
    type(steady_points_type), intent(in) :: points
    logical :: stable(points%n)
    integer :: i
    do i = 1, points%n
      stable(i) = max(maxval(real(points%eigenvalues(:, i))), points%resting(i)) &
                  <= 1.0e-9_wp*maxval(points%frame(:, i))
    end do
  end function stable_points

  !> Write the table NAME in a folder, which is made if need be; the table is there whole or
  !! not at all.
  subroutine write_scales(folder, name, job, points, coordinates, header, status)
    character(len=*), intent(in) :: folder, name
    type(scales_job), intent(in) :: job
    type(steady_points_type), intent(in), target :: points
    character(len=*), intent(in) :: coordinates(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(table_type) :: table
    integer :: d, n

    n = points%n
    call table%note('steady motions by multiple scales to third order')
    call table%note('first harmonic of u = Re X exp(i p t) under the load f cos(p t); amplitudes ' &
                    //'of the modes; largest growth; sizes of the three orders; estimated error ' &
                    //'of X, of the coordinate where it is largest')
    call table%hold_reals(trim(job%parameter), job%values(points%value(:n)))
    call table%hold_integers('stable', merge(1, 0, stable_points(points)))
    do d = 1, size(coordinates)
      call table%add_complex(trim(coordinates(d)), points%harmonic(d, :n))
    end do
    do d = 1, size(points%a, 1)
      call table%hold_reals('mode_'//show(d), 2.0_wp*abs(points%a(d, :n)))
    end do
    call table%hold_reals('growth', max(maxval(real(points%eigenvalues(:, :n)), 1), &
                                       points%resting(:n)))
    do d = 1, 3
      call table%add_reals('order_'//show(d), points%sizes(d, :n))
    end do
    call table%hold_reals('error_estimate', maxval(points%harmonic_errors(:, :n), 1))
    call table%write(folder, name, header, status)
  end subroutine write_scales

end module viscovib_scales_job
