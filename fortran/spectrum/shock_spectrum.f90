!> The shock response spectrum of a record, with its units, and as a table.
module viscovib_shock_spectrum
  use viscovib_constants, only: pi, standard_gravity
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_shock_response, only: absolute_acceleration, relative_displacement, shock_response
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: check_damping, find_shock_spectrum, shock_table, steps_of

  character(len=*), parameter, public :: spectrum_kinds(3) = &
    [character(len=21) :: 'absolute_acceleration', 'relative_displacement', 'pseudo_velocity']
  integer, parameter :: of_acceleration = 1, of_displacement = 2
  !> Difference of equal steps, relative to their length.
  real(wp), parameter :: uneven = 1.0e-9_wp

contains

  !> Magnitudes of the extremes at frequencies in any order.
  subroutine find_shock_spectrum(record, steps, hz, damping, kind, unit, extremes, status)
    !> Acceleration of the base, linear between n >= 2 samples, and times between them: one, or
    !! (n - 1).
    real(wp), intent(in) :: record(:), steps(:)
    !> Natural frequencies (Hz), shape (m), and the damping ratio.
    real(wp), intent(in) :: hz(:), damping
    !> Index in `spectrum_kinds`; unit of the record, "m/s^2" or "g".
    integer, intent(in) :: kind
    character(len=*), intent(in) :: unit
    !> Largest value and magnitude of the smallest one, up to the last sample and after it, shape
    !! (4, m).
    real(wp), allocatable, intent(out) :: extremes(:, :)
    type(status_type), intent(out) :: status
    real(wp) :: omega(size(hz)), factor
    integer, allocatable :: order(:)

    call check(record, steps, hz, damping, status)
    if (status%failed()) return
    omega = 2.0_wp*pi*hz
    ! Together only those of nearly the same length of step: sorted.
    order = ascending(omega)
    allocate (extremes(4, size(hz)))
    call shock_response(record, steps, omega(order), damping, &
                        merge(absolute_acceleration, relative_displacement, &
                              kind == of_acceleration), extremes)
    extremes(:, order) = extremes
    extremes(2::2, :) = -extremes(2::2, :)
    if (kind /= of_acceleration) then
      factor = merge(standard_gravity, 1.0_wp, unit == 'g')
      extremes = extremes*spread(factor/omega**merge(2, 1, kind == of_displacement), 1, 4)
    end if
    ! No -0.
    extremes = extremes + 0.0_wp
  end subroutine find_shock_spectrum

  subroutine check(record, steps, hz, damping, status)
    real(wp), intent(in) :: record(:), steps(:), hz(:), damping
    type(status_type), intent(out) :: status
    real(wp) :: theta(2)
    call check_damping(damping, status)
    if (status%failed()) return
    theta = 2.0_wp*pi*[minval(hz)*minval(steps), maxval(hz)*maxval(steps)]
    if (minval(hz) <= 0.0_wp) then
      call fail(status, status_input_error, 'frequencies', 'frequencies: '//show(minval(hz)) &
                //' Hz: must be greater than 0')
    else if (theta(1) < 1.0e-100_wp .or. .not. theta(2) <= 1.0e20_wp) then
      call fail(status, status_input_error, 'frequencies', 'frequencies: must be within 1e-100 ' &
                //'and 1e19 of the sampling rate')
    else if (maxval(abs(record)) > 1.0e150_wp) then
      call fail(status, status_input_error, 'record', 'record: values beyond 1e150 exceed the ' &
                //'range of numbers')
    end if
  end subroutine check

  subroutine check_damping(damping, status)
    real(wp), intent(in) :: damping
    type(status_type), intent(out) :: status
    call set_ok(status)
    if (damping < 1.0_wp) return
    call fail(status, status_input_error, 'damping', 'damping = '//show(damping) &
              //': must be less than 1 (a damping ratio: 5 % of critical is 0.05)')
  end subroutine check_damping

  !> Indices of numbers in ascending order (merge sort).
  pure recursive function ascending(values) result(order)
    real(wp), intent(in) :: values(:)
    integer :: order(size(values)), left(size(values)/2), half, i, j, k
    integer :: right(size(values) - size(left))

    order = [(i, i=1, size(values))]
    half = size(values)/2
    if (half == 0) return
    left = ascending(values(:half))
    right = half + ascending(values(half + 1:))
    i = 1
    j = 1
    do k = 1, size(values)
      if (j > size(right)) then
        order(k:) = left(i:)
        return
      else if (i > half) then
        order(k:) = right(j:)
        return
      else if (values(right(j)) < values(left(i))) then
        order(k) = right(j)
        j = j + 1
      else
        order(k) = left(i)
        i = i + 1
      end if
    end do
  end function ascending

  !> Times between n >= 2 samples: one if they are equal.
  pure function steps_of(t) result(steps)
    real(wp), intent(in) :: t(:)
    real(wp), allocatable :: steps(:)
    real(wp) :: step, off
    integer :: i, n
    n = size(t)
    step = (t(n) - t(1))/(n - 1)
    off = maxval(abs([(t(i) - (t(1) + step*(i - 1)), i=1, n)]))
    if (off <= uneven*max(step, 1.0e-6_wp*abs(t(n)))) then
      steps = [step]
    else
      steps = t(2:) - t(:n - 1)
    end if
  end function steps_of

  !> The table: magnitudes over the frequency, of both signs and parts together and apart.
  subroutine shock_table(table, hz, extremes, damping, kind, unit, peak, duration)
    type(table_type), intent(inout) :: table
    real(wp), intent(in) :: hz(:), extremes(:, :), damping
    integer, intent(in) :: kind
    !> Of the record, with its largest magnitude (m/s^2) and its length (s).
    character(len=*), intent(in) :: unit
    real(wp), intent(in) :: peak, duration
    character(len=:), allocatable :: shown

    shown = unit
    if (kind /= of_acceleration) shown = trim(merge('m  ', 'm/s', kind == of_displacement))
    call table%note('kind '//trim(spectrum_kinds(kind))//', damping ratio '//trim(exact(damping)) &
                    //'; frequency in Hz, magnitudes in '//shown)
    call table%note('record of '//trim(exact(duration))//' s, peak '//trim(exact(peak))//' m/s^2')
    call table%hold_reals('frequency', hz)
    call table%hold_reals('maximax', maxval(extremes, 1))
    call table%hold_reals('positive', maxval(extremes(1::2, :), 1))
    call table%hold_reals('negative', maxval(extremes(2::2, :), 1))
    call table%hold_reals('primary', maxval(extremes(:2, :), 1))
    call table%hold_reals('residual', maxval(extremes(3:, :), 1))
    call table%hold_reals('primary_positive', extremes(1, :))
    call table%hold_reals('primary_negative', extremes(2, :))
    call table%hold_reals('residual_positive', extremes(3, :))
    call table%hold_reals('residual_negative', extremes(4, :))
  end subroutine shock_table

end module viscovib_shock_spectrum
