!> A motion in time of a polynomial system without memory, or with one of exponentials, as one job.
module viscovib_polynomial_job
  use viscovib_counters, only: count_up, counted_idle, counting
  use viscovib_hidden_memory, only: count_hidden
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: branches
  use viscovib_load, only: load_type
  use viscovib_plan_text, only: tell_idle, tell_laws, tell_zeros
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: new_polynomial_motion, polynomial_motion_type
  use viscovib_reduction, only: moved_coordinates, reduce, state_mask
  use viscovib_status, only: status_type, things
  use viscovib_transient_job, only: run_transient, trajectory_type, transient_job
  use viscovib_transient_plan, only: plan_transient
  implicit none
  private

  public :: run_polynomial_job, plan_polynomial

contains

  !> The motion wanted; coordinates that nothing moves are left out of the equations.
  subroutine run_polynomial_job(job, system, load, nu, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency of the load; fastest frequency of system and load (rad/s).
    real(wp), intent(in) :: nu, fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(polynomial_type) :: reduced
    type(transient_job) :: part_job
    type(load_type) :: part
    logical :: moved(system%n_dof())

    moved = moved_coordinates(system, driven(job, system, load))
    if (all(moved)) then
      call run_whole(job, system, load, nu, fastest, trajectory, status)
      return
    end if
    call reduce(system, moved, reduced)
    call load%take_part(moved, part)
    part_job = job
    part_job%initial = pack(job%initial, state_mask(moved))
    call run_whole(part_job, reduced, part, nu, fastest, trajectory, status)
    if (.not. status%failed()) call trajectory%spread_out(moved)
  end subroutine run_polynomial_job

  !> Coordinates that the load or the start moves; of a watched motion all are computed, and where
  !! laws switch: what they know is kept in one order, whatever acts later on.
  pure function driven(job, system, load)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    logical :: driven(size(job%initial)/2)
    integer :: i
    driven = load%drives(system) .or. abs(job%initial(1::2)) > 0.0_wp &
             .or. abs(job%initial(2::2)) > 0.0_wp .or. allocated(job%watched)
    do i = 1, size(system%laws)
      driven = driven .or. system%laws(i)%state > 0 .or. any(branches(system%laws(i)%program%code))
    end do
  end function driven

  !> The same with all coordinates.
  subroutine run_whole(job, system, load, nu, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(polynomial_motion_type) :: motion

    call new_polynomial_motion(motion, system, load, nu, status, in_sections=.true.)
    if (status%failed()) return
    if (counting) call count_up(counted_idle, count( &
                                .not. moved_coordinates(system, driven(job, system, load))))
    call run_transient(job, motion, fastest, trajectory, status)
  end subroutine run_whole

  !> What will be computed and what is skipped, with the reasons.
  function plan_polynomial(job, system, load) result(text)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    text = 'skips: memory (no kernels)'
    if (count_hidden(system) > 0) text = 'computes: memory by '//things(count_hidden(system), &
                                                                        'exponential')
    text = plan_transient(job)//text//new_line('a') &
           //tell_idle(moved_coordinates(system, driven(job, system, load))) &
           //tell_laws(system)//tell_zeros(system, load)
  end function plan_polynomial

end module viscovib_polynomial_job
