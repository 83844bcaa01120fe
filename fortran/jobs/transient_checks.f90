!> What a motion in time is asked for: whether it can be computed, before it is.
module viscovib_transient_checks
  use viscovib_checks, only: check_finite, check_positive
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_limits, only: max_time_tolerance, min_time_tolerance
  use viscovib_status, only: fail, show, status_input_error, status_type
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
    integer :: i

    do i = 1, size(job%initial)
      call check_finite('initial', job%initial(i), status)
      if (status%failed()) return
    end do
    q = 0.0_wp
    q(:size(job%initial)/2) = job%initial(1::2)
    if (.not. system%physical(q)) then
      call fail(status, status_input_error, 'initial', 'initial: this state is outside what the ' &
                //'equations describe (z must be greater than -1)')
      return
    end if
    call check_times(job, status)
  end subroutine check_transient

  !> End, step, tolerance and what is kept.
  subroutine check_times(job, status)
    class(transient_job), intent(in) :: job
    type(status_type), intent(out) :: status

    call check_positive('t_end', job%t_end, status)
    if (status%failed()) return
    call check_finite('dt', job%dt, status)
    if (status%failed()) return
    if (job%dt < 0.0_wp .or. job%dt > job%t_end) then
      call fail(status, status_input_error, 'dt', 'dt = '//show(job%dt)//': must be greater ' &
                //'than 0 and not exceed t_end = '//show(job%t_end)//', or 0 to be found')
      return
    end if
    call check_finite('tolerance', job%tolerance, status)
    if (status%failed()) return
    call check_finite('rtol', job%relative, status)
    if (status%failed()) return
    if (job%relative > 0.0_wp .and. job%relative < min_time_tolerance &
        .or. job%relative > max_time_tolerance &
        .or. job%relative < 0.0_wp) then
      call fail(status, status_input_error, 'rtol', 'rtol = '//show(job%relative) &
                //': must be in [1e-13, 1]')
      return
    else if (job%relative > 0.0_wp .and. job%dt > 0.0_wp) then
      call fail(status, status_input_error, 'rtol', 'rtol = '//show(job%relative) &
                //': finds the step, must not be given with dt')
      return
    end if
    if (job%tolerance < min_time_tolerance .or. job%tolerance > max_time_tolerance) then
      if (abs(job%tolerance) > 0.0_wp) then
        call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(job%tolerance) &
                  //': must be in [1e-13, 1]')
        return
      end if
    end if
    if (job%save_every < 1) then
      call fail(status, status_input_error, 'save_every', 'save_every = '//show(job%save_every) &
                //': must be at least 1')
      return
    end if
    if (job%dt > 0.0_wp) then
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
