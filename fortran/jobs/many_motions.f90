!> Results of many motions, and their change with a smaller step size.
module viscovib_many_motions
  use viscovib_kinds, only: wp
  use viscovib_event_errors, only: located
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged
  implicit none
  private

  public :: compare

  !> Smallest unit of comparison of a coordinate, relative to the largest coordinate.
  real(wp), parameter :: smallest = 1.0e-6_wp

  !> Results; the run is the last index.
  type, public :: many_motions
    real(wp), allocatable :: state(:, :), peak(:, :), mean(:, :), rms(:, :)
    real(wp), allocatable :: lyapunov(:), lyapunov_error(:), t_reached(:)
    real(wp), allocatable :: sections(:, :, :)
    integer, allocatable :: ended(:)
    logical, allocatable :: missed(:)
  end type many_motions

contains

  !> Test if motions with half the step size agree, and compute their difference; if they agree, the
  !! difference includes the rounding error.
  subroutine compare(coarse, fine, absolute, relative, change, met)
    type(many_motions), intent(in) :: coarse
    !> Exponents get an error of at least their difference between the two runs.
    type(many_motions), intent(inout) :: fine
    real(wp), intent(in) :: absolute, relative
    real(wp), intent(out) :: change
    logical, intent(out) :: met
    real(wp), dimension(size(fine%state, 1), size(fine%state, 2)) :: along, parts
    real(wp), dimension(size(fine%state, 1)) :: sizes, tops
    real(wp), dimension(size(fine%ended)) :: late, moved
    real(wp) :: rounded
    logical :: alive(size(fine%ended))
    integer :: d, i

    alive = coarse%ended == run_completed .and. fine%ended == run_completed
    parts = abs(fine%state - coarse%state)
    ! For a diverged state only the time is compared.
    where (spread(fine%ended == run_diverged, 1, size(parts, 1))) parts = 0.0_wp
    moved = abs(fine%t_reached - coarse%t_reached)
    along = 0.0_wp
    tops = 0.0_wp
    rounded = 0.0_wp
    do i = 1, size(alive)
      ! Peaks and means of a motion that stopped are NaN.
      if (.not. alive(i)) cycle
      along(:, i) = max(abs(fine%peak(:, i) - coarse%peak(:, i)), &
                        abs(fine%mean(:, i) - coarse%mean(:, i)), &
                        abs(fine%rms(:, i) - coarse%rms(:, i)))
      tops = max(tops, fine%peak(:, i))
      rounded = max(rounded, maxval(abs(fine%state(:, i))), maxval(fine%peak(:, i)))
    end do
    change = max(maxval(parts), maxval(along), maxval(moved))
    met = .false.
    if (any(coarse%ended /= fine%ended .or. fine%ended == run_coarse)) change = huge(1.0_wp)
    if (.not. change < huge(1.0_wp)) return
    do d = 1, size(sizes)
      sizes(d) = maxval([0.0_wp, pack(abs(fine%state(d, :)), alive)])
    end do
    sizes = absolute + relative*max(sizes, smallest*maxval(sizes))
    tops = absolute + relative*max(tops, smallest*maxval(tops))
    late = absolute + relative*fine%t_reached
    met = all(moved <= late) .and. all(alive .or. maxval(parts, 1) <= late)
    do d = 1, size(sizes)
      met = met .and. all(.not. alive .or. (parts(d, :) <= sizes(d) .and. along(d, :) <= tops(d)))
    end do
    if (.not. met) return
    do i = 1, size(alive)
      ! For stopped motions both are NaN.
      if (alive(i)) fine%lyapunov_error(i) = max(fine%lyapunov_error(i), &
                                                 abs(fine%lyapunov(i) - coarse%lyapunov(i)))
    end do
    change = max(change, 4.0_wp*epsilon(1.0_wp)*rounded)
    if (.not. all(alive)) change = max(change, located*max(1.0_wp, maxval(fine%t_reached, &
                                                                          mask=.not. alive)))
  end subroutine compare

end module viscovib_many_motions
