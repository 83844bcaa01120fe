!> The shock response spectrum of a coordinate of a motion, or of a record.
module viscovib_shock_spectrum_job
  use viscovib_constants, only: standard_gravity
  use viscovib_job, only: table_sink
  use viscovib_kinds, only: wp
  use viscovib_record_doubts, only: doubt_record
  use viscovib_shock_spectrum, only: find_shock_spectrum, shock_table, steps_of
  use viscovib_status, only: fail, show, status_input_error, status_type, things
  use viscovib_table, only: table_type
  implicit none
  private

  public :: shock_spectrum_job

  !> Options of &shock_spectrum.
  type :: shock_spectrum_job
    logical :: wanted = .false.
    !> Frequencies (Hz), damping ratio, and index in `spectrum_kinds`.
    real(wp), allocatable :: hz(:)
    real(wp) :: damping = 0.0_wp
    integer :: kind = 1
    !> The coordinate that carries the oscillators; 0: a record with its unit.
    integer :: place = 0
    real(wp), allocatable :: times(:), values(:)
    character(len=:), allocatable :: unit
  contains
    procedure :: put
    procedure :: plan
  end type shock_spectrum_job

contains

  !> The line of a plan.
  function plan(self, coordinates) result(text)
    class(shock_spectrum_job), intent(in) :: self
    character(len=*), intent(in) :: coordinates(:)
    character(len=:), allocatable :: text
    text = 'a record'
    if (self%place > 0) text = trim(coordinates(self%place))
    text = 'computes: shock response spectrum of '//text//' at ' &
           //things(size(self%hz), 'frequency', 'frequencies')//new_line('a')
  end function plan

  !> Compute the spectrum, and give its table to the sink.
  subroutine put(self, t, accelerations, sink, doubts, status)
    class(shock_spectrum_job), intent(in) :: self
    !> Times of the states kept, and absolute accelerations of all coordinates at these (m/s^2); not
    !! used for a record.
    real(wp), intent(in) :: t(:)
    real(wp), allocatable, intent(in) :: accelerations(:, :)
    class(table_sink), intent(inout) :: sink
    !> What is doubtful about the accelerations, see `doubt_record`.
    character(len=:), allocatable, intent(out) :: doubts
    type(status_type), intent(out) :: status
    type(table_type) :: table
    real(wp), allocatable :: times(:), values(:), extremes(:, :)
    real(wp) :: factor

    doubts = ''
    if (self%place == 0) then
      times = self%times
      values = self%values
    else
      times = t
      values = accelerations(self%place, :)
      if (size(t) < 2) then
        call fail(status, status_input_error, 'record', 'record: '//show(size(t)) &
                  //' states kept, must be at least 2')
        return
      end if
      call doubt_record('record', values, self%unit, .true., doubts)
    end if
    call find_shock_spectrum(values, steps_of(times), self%hz, self%damping, self%kind, self%unit, &
                             extremes, status)
    if (status%failed()) return
    factor = merge(standard_gravity, 1.0_wp, self%unit == 'g')
    call shock_table(table, self%hz, extremes, self%damping, self%kind, self%unit, &
                     factor*maxval(abs(values)), times(size(times)) - times(1))
    call sink%put('shock_spectrum', table, status)
  end subroutine put

end module viscovib_shock_spectrum_job
