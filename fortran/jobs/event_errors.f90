!> Errors of the events of a run whose step was searched, from the run before.
module viscovib_event_errors
  use viscovib_kinds, only: wp
  use viscovib_event_point_errors, only: event_point_errors
  use viscovib_time_run, only: run_completed, run_event
  use viscovib_trajectory, only: rounding_of, trajectory_type
  implicit none
  private

  public :: differences_type, find_differences, set_error

  !> Relative error of the time of a stop inside a step.
  real(wp), parameter, public :: located = 1.0e-12_wp
  !> Relative rounding error of the times of states of two runs.
  real(wp), parameter :: one_time = 1.0e-12_wp

  !> Differences of the states of two runs, a column each, and their times; `least` is the amplified
  !! rounding error, which the differences do not show.
  type :: differences_type
    real(wp), allocatable :: times(:), apart(:, :)
    real(wp) :: least = 0.0_wp
    !> True if states have a unique form, so that those of events can be compared.
    logical :: one_way = .true.
  end type differences_type

contains

  !> Differences of two runs; `grown`: amplified rounding errors; `one_way`: as above.
  pure subroutine find_differences(coarse, fine, grown, one_way, found)
    type(trajectory_type), intent(in) :: coarse, fine
    real(wp), intent(in) :: grown
    logical, intent(in) :: one_way
    type(differences_type), intent(out) :: found
    logical :: same(min(size(coarse%t), size(fine%t))), looked
    integer :: i, k

    found%least = grown
    found%one_way = one_way
    same = abs(coarse%t(:size(same)) - fine%t(:size(same))) &
           <= one_time*max(abs(fine%t_reached), 1.0e-300_wp)
    looked = one_way .and. allocated(coarse%looks) .and. allocated(fine%looks)
    if (looked) looked = size(fine%looks, 2) > 0 .and. size(coarse%looks, 2) == size(fine%looks, 2)
    k = merge(1, 0, looked)
    allocate (found%times(count(same) + k), found%apart(size(fine%states, 1), count(same) + k))
    if (looked) then
      found%times(1) = 0.0_wp
      found%apart(:, 1) = maxval(abs(fine%looks - coarse%looks), 2)
    end if
    do i = 1, size(same)
      if (.not. same(i)) cycle
      k = k + 1
      found%times(k) = fine%t(i)
      found%apart(:, k) = abs(fine%states(:, i) - coarse%states(:, i))
    end do
    if (allocated(fine%rows)) call spread_rows(found%apart, fine%rows, size(fine%whole, 1))
  end subroutine find_differences

  !> Extend some rows of differences to all n: other rows get the largest difference.
  pure subroutine spread_rows(apart, rows, n)
    real(wp), allocatable, intent(inout) :: apart(:, :)
    integer, intent(in) :: rows(:), n
    real(wp), allocatable :: all_rows(:, :)
    allocate (all_rows, source=spread(maxval(apart, 1), 1, n))
    all_rows(rows, :) = apart
    call move_alloc(all_rows, apart)
  end subroutine spread_rows

  !> Set the errors of a run, from its change, of its events, and of its stop.
  subroutine set_error(run, coarse, change, differences, watched)
    type(trajectory_type), intent(inout) :: run
    type(trajectory_type), intent(in) :: coarse
    real(wp), intent(in) :: change
    type(differences_type), intent(in) :: differences
    !> Events, as in `new_watch`; not allocated: none.
    real(wp), allocatable, intent(in) :: watched(:)
    real(wp) :: least, late
    integer :: n

    run%error = max(change, rounding_of(run))
    late = -1.0_wp
    if (allocated(watched) .and. allocated(run%watch) .and. allocated(coarse%watch)) then
      least = max(rounding_of(run), differences%least)
      ! Two runs may have the same error at kinks.
      if (run%over_kinks .or. .not. differences%one_way) least = run%error
      n = size(run%states, 1)/2
      if (allocated(run%rows)) n = size(run%whole, 1)/2
      associate (found => run%watch%n_found)
        allocate (run%event_point_errors(2, found))
        call event_point_errors(watched, run%watch%rows(n, found), &
                            coarse%watch%rows(n, coarse%watch%n_found), differences%times, &
                            differences%apart, least, &
                            [0.0_wp, min(run%t_reached, coarse%t_reached)], differences%one_way, &
                            run%event_point_errors)
        if (run%outcome == run_event) late = run%event_point_errors(1, found)
      end associate
    end if
    if (run%outcome == run_completed) return
    ! The same small steps locate the stop every time.
    if (.not. late >= 0.0_wp) late = located*max(1.0_wp, run%t_reached)
    run%error = max(run%error, late)
  end subroutine set_error

end module viscovib_event_errors
