!> Doubts about records of an acceleration: a unit that looks wrong, an offset.
module viscovib_record_doubts
  use viscovib_constants, only: standard_gravity
  use viscovib_kinds, only: wp
  use viscovib_rounded, only: six_digits
  use viscovib_status, only: show
  implicit none
  private

  public :: doubt_record

  !> Acceleration (m/s^2) above which the unit of a record is doubted.
  real(wp), parameter :: large = 4000.0_wp
  !> Part of a record at each end, relative difference and relative size of an offset.
  real(wp), parameter :: tail_part = 0.05_wp, alike = 0.3_wp, least_offset = 1.0e-6_wp

contains

  !> Lines about a record, each terminated by a new-line character; empty without doubts.
  subroutine doubt_record(name, values, unit, is_record, text)
    character(len=*), intent(in) :: name
    !> In m/s^2.
    real(wp), intent(in) :: values(:)
    !> "m/s^2" or "g", in which it was given.
    character(len=*), intent(in) :: unit
    !> False for a formula, whose ends are no offsets.
    logical, intent(in) :: is_record
    character(len=:), allocatable, intent(out) :: text
    real(wp) :: peak, offset, means(4)
    integer :: half, n, tail

    text = ''
    peak = maxval(abs(values))
    if (peak > large) text = name//': its peak is '//show(six_digits(peak))//' m/s^2 = ' &
                             //show(six_digits(peak/standard_gravity))//' g: check that it is ' &
                             //'in '//unit//new_line('a')
    ! Four stretches at both ends have the same mean: an offset, unlike the flanks of a pulse.
    n = size(values)
    tail = int(tail_part*n)
    if (tail < 4 .or. .not. is_record) return
    half = tail/2
    means = [sum(values(:half))/half, sum(values(half + 1:tail))/(tail - half), &
             sum(values(n - tail + 1:n - half))/(tail - half), sum(values(n - half + 1:))/half]
    offset = sum(means)/4.0_wp
    if (maxval(abs(means - offset)) >= alike*abs(offset)) return
    if (abs(offset) <= least_offset*peak) return
    if (unit == 'g') offset = offset/standard_gravity
    text = text//name//': begins and ends with an offset of '//show(six_digits(offset))//' '//unit &
           //', with which the base drifts: subtract it'//new_line('a')
  end subroutine doubt_record

end module viscovib_record_doubts
