!> A motion in time of the pendulum as one job; where nothing makes it swing, of its
!! spring alone.
module viscovib_pendulum_job
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: new_pendulum, pendulum_type
  use viscovib_pendulum_spring, only: new_spring, spring_type, swings
  use viscovib_plan_text, only: tell_idle
  use viscovib_status, only: status_type
  use viscovib_trajectory, only: shaken, trajectory_type
  use viscovib_transient_job, only: run_transient, transient_job
  use viscovib_transient_plan, only: plan_transient
  implicit none
  private

  public :: run_pendulum_job, plan_pendulum

  logical, parameter :: spring_only(3) = [.true., .false., .false.]
  !> All numbers are other, each its own way: that brings as much as what `grown_of` adds.
  real(wp), parameter, public :: part_of_numbers = shaken/8.0_wp

contains

  subroutine run_pendulum_job(job, pendulum, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    !> Fastest frequency of pendulum and loads.
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(transient_job) :: part_job
    type(spring_type) :: spring
    type(spring_type) :: other_spring
    type(pendulum_type) :: other

    call new_pendulum(other, pendulum%parameters%shaken(part_of_numbers), status)
    if (status%failed()) return
    if (swings(pendulum, job%initial) .or. allocated(job%watched)) then
      call run_transient(job, pendulum, fastest, trajectory, status, other, part_of_numbers)
      return
    end if
    call new_spring(spring, pendulum)
    call new_spring(other_spring, other)
    part_job = job
    part_job%initial = job%initial(:2)
    call run_transient(part_job, spring, fastest, trajectory, status, other_spring, part_of_numbers)
    if (.not. status%failed()) call trajectory%spread_out(spring_only)
  end subroutine run_pendulum_job

  !> What will be computed and what is skipped, with the reasons.
  function plan_pendulum(job, pendulum) result(text)
    type(transient_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    character(len=:), allocatable :: text
    text = plan_transient(job)
    if (swings(pendulum, job%initial) .or. allocated(job%watched)) return
    text = text//tell_idle(spring_only)
  end function plan_pendulum

end module viscovib_pendulum_job
