!> Checks of the options of a motion in time, before it is computed.
module viscovib_transient_checks
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_transient_job, only: max_kept, max_steps, transient_job
  implicit none
  private

  public :: check_transient, check_times

contains

  subroutine check_transient(job, system, status)
    class(transient_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    type(status_type), intent(out) :: status
    real(wp) :: q(system%n_dof)

    q = 0.0_wp
    q(:size(job%initial)/2) = job%initial(1::2)
    if (.not. system%physical(q)) then
      call fail(status, status_input_error, 'initial', 'initial: this state is outside what the ' &
                //'equations describe (z must be greater than -1)')
      return
    end if
    call check_times(job, status)
  end subroutine check_transient

  !> Check the end, the step, the tolerance and the kept states.
  subroutine check_times(job, status)
    class(transient_job), intent(in) :: job
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (job%dt > job%t_end) then
      call fail(status, status_input_error, 'dt', 'dt = '//show(job%dt)//': must be greater ' &
                //'than 0 and not exceed t_end = '//show(job%t_end)//', or 0 to be found')
    else if (job%relative > 0.0_wp .and. job%dt > 0.0_wp) then
      call fail(status, status_input_error, 'rtol', 'rtol = '//show(job%relative) &
                //': finds the step, must not be given with dt')
    else if (job%dt > 0.0_wp) then
      if (job%t_end/job%dt > max_steps) then
        call fail(status, status_input_error, 'dt', 't_end/dt = '//show(job%t_end/job%dt) &
                  //': must be at most '//show(max_steps))
      else if (job%t_end/job%dt/job%save_every > max_kept) then
        call fail(status, status_input_error, 'save_every', 'save_every = ' &
                  //show(job%save_every)//': would keep more than '//show(max_kept)//' states')
      end if
    end if
  end subroutine check_times

end module viscovib_transient_checks
