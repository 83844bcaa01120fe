!> A motion in time of the pendulum as one job; if it cannot swing, a motion of its
!! spring only.
module viscovib_pendulum_job
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_spring, only: swings
  use viscovib_piece_runs, only: piece_runs
  use viscovib_plain_pieces, only: part_of_numbers, pendulum_equations
  use viscovib_plan_text, only: report_idle
  use viscovib_status, only: status_type
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: run_motion, transient_job
  use viscovib_transient_plan, only: plan_transient
  implicit none
  private

  public :: run_pendulum_job, plan_pendulum

  logical, parameter :: spring_only(3) = [.true., .false., .false.]

contains

  subroutine run_pendulum_job(job, pendulum, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(pendulum_type), intent(in), target :: pendulum
    !> Fastest frequency of pendulum and loads.
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(pendulum_equations), target :: equations
    type(piece_runs) :: runs

    equations%system => pendulum
    equations%method = job%method
    equations%swings = swings(pendulum, job%initial) .or. allocated(job%watched)
    equations%change = part_of_numbers
    runs%equations => equations
    runs%first%tolerance = job%solved()
    call run_motion(runs, job, job%t_end*fastest/(0.5_wp*pi), [real(wp) ::], 1, trajectory, status)
  end subroutine run_pendulum_job

  !> Text of the plan: computed and skipped parts, with reasons.
  function plan_pendulum(job, pendulum) result(text)
    type(transient_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    character(len=:), allocatable :: text
    text = plan_transient(job)
    if (swings(pendulum, job%initial) .or. allocated(job%watched)) return
    text = text//report_idle(spring_only)
  end function plan_pendulum

end module viscovib_pendulum_job
