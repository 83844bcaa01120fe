!> The &multiple_scales group of a scene.
module viscovib_scales_groups
  use viscovib_checks, only: check_positive
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_response_groups, only: read_range
  use viscovib_scales_job, only: scales_job
  use viscovib_scales_response, only: vary_amplitude, vary_frequency
  use viscovib_status, only: status_type
  implicit none
  private

  public :: read_pendulum_scales, read_oscillator_scales

contains

  subroutine read_pendulum_scales(reader, job)
    type(group_reader), intent(inout) :: reader
    type(scales_job), intent(out) :: job
    character(len=:), allocatable :: word
    integer :: which

    job%parameter = reader%read_text('parameter', choice=which)
    job%load = modulo(which - 1, 3) + 1
    job%vary = merge(vary_frequency, vary_amplitude, which <= 3)
    call read_values(reader, job)
    word = reader%read_text('ordering', choice=job%ordering)
  end subroutine read_pendulum_scales

  !> The load is the scene's: one frequency, one phase.
  subroutine read_oscillator_scales(reader, load, job)
    type(group_reader), intent(inout) :: reader
    type(load_type), intent(in) :: load
    type(scales_job), intent(out) :: job
    integer :: which

    job%parameter = reader%read_text('parameter', choice=which)
    job%vary = merge(vary_frequency, vary_amplitude, which == 1)
    call read_values(reader, job)
    if (job%vary == vary_amplitude) then
      job%nu = reader%read_real('nu')
    else
      call reader%refuse(['nu'], 'the frequency is what is varied')
    end if
    if (load%varies()) then
      call reader%complain('parameter', '&load: depends on nu, must be constant for ' &
                           //'&multiple_scales')
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

    call read_range(reader, '', job%values)
    job%tolerance = reader%read_real('tolerance')
    if (reader%status%failed() .or. job%vary /= vary_frequency) return
    call check_positive('from', job%values(1), status)
    call reader%place(status)
  end subroutine read_values

end module viscovib_scales_groups
