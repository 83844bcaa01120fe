!> How sure the passages of a run are whose step was found, by the run before.
module viscovib_event_errors
  use viscovib_kinds, only: wp
  use viscovib_passage_errors, only: passage_errors
  use viscovib_simulate, only: run_completed, run_event
  use viscovib_trajectory, only: rounding_of, trajectory_type
  implicit none
  private

  public :: differences_type, differences_of, tell_error

  !> Relative error of the time of a stop inside a step.
  real(wp), parameter, public :: located = 1.0e-12_wp
  !> Part of the end of a run by which times of states of two runs may differ by rounding.
  real(wp), parameter :: one_time = 1.0e-12_wp

  !> By how much states of two runs differ, a column each, and when; the least is what roundings
  !! become, which these do not tell.
  type :: differences_type
    real(wp), allocatable :: times(:), apart(:, :)
    real(wp) :: least = 0.0_wp
    !> Whether states are told in one way, so that those of passages can be compared.
    logical :: one_way = .true.
  end type differences_type

contains

  !> Of two runs, the second the finer one; `grown`: what roundings become; `one_way`: as above.
  pure type(differences_type) function differences_of(coarse, fine, grown, one_way) result(found)
    type(trajectory_type), intent(in) :: coarse, fine
    real(wp), intent(in) :: grown
    logical, intent(in) :: one_way
    integer, allocatable :: same(:)
    logical :: looked
    integer :: i, n

    found%least = grown
    found%one_way = one_way
    n = min(size(coarse%t), size(fine%t))
    same = pack([(i, i=1, n)], abs(coarse%t(:n) - fine%t(:n)) &
                <= one_time*max(abs(fine%t_reached), 1.0e-300_wp))
    found%times = fine%t(same)
    found%apart = abs(fine%states(:, same) - coarse%states(:, same))
    looked = one_way .and. allocated(coarse%looks) .and. allocated(fine%looks)
    if (looked) looked = size(fine%looks, 2) > 0 .and. size(coarse%looks, 2) == size(fine%looks, 2)
    if (.not. looked) return
    found%times = [0.0_wp, found%times]
    found%apart = reshape([maxval(abs(fine%looks - coarse%looks), 2), found%apart], &
                          [size(found%apart, 1), size(found%times)])
  end function differences_of

  !> The error of a run, by how much it changed, of its passages, and of where it stops.
  subroutine tell_error(run, coarse, change, differences, watched)
    type(trajectory_type), intent(inout) :: run
    type(trajectory_type), intent(in) :: coarse
    real(wp), intent(in) :: change
    type(differences_type), intent(in) :: differences
    !> Events, as of `new_watch`; not allocated: none.
    real(wp), allocatable, intent(in) :: watched(:)
    real(wp) :: least, late
    integer :: n

    run%error = max(change, rounding_of(run))
    late = -1.0_wp
    if (allocated(watched) .and. allocated(run%watch) .and. allocated(coarse%watch)) then
      least = max(rounding_of(run), differences%least)
      ! Two runs may be wrong alike at kinks.
      if (run%over_kinks .or. .not. differences%one_way) least = run%error
      n = size(run%states, 1)/2
      associate (found => run%watch%n_found)
        allocate (run%passage_errors(2, found))
        call passage_errors(watched, run%watch%rows(n, found), &
                            coarse%watch%rows(n, coarse%watch%n_found), differences%times, &
                            differences%apart, least, &
                            [0.0_wp, min(run%t_reached, coarse%t_reached)], differences%one_way, &
                            run%passage_errors)
        if (run%outcome == run_event) late = run%passage_errors(1, found)
      end associate
    end if
    if (run%outcome == run_completed) return
    ! Where it stops is found by the same small steps every time.
    if (.not. late >= 0.0_wp) late = located*max(1.0_wp, run%t_reached)
    run%error = max(run%error, late)
  end subroutine tell_error

end module viscovib_event_errors
