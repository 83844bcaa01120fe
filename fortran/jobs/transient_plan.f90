!> Text of the plan of a motion in time: computed and skipped parts.
module viscovib_transient_plan
  use viscovib_column_notes, only: step_given_note
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: method_order, transient_methods
  use viscovib_status, only: show, things
  use viscovib_transient_job, only: first_steps, transient_job
  implicit none
  private

  public :: plan_transient, plan_steps

contains

  !> Text of the plan: computed and skipped parts, with reasons.
  function plan_transient(job) result(text)
    class(transient_job), intent(in) :: job
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')

    text = 'computes: motion to t = '//show(job%t_end)//' by ' &
           //trim(transient_methods(job%method))//', order '//show(method_order(job%method))//nl &
           //plan_steps(job)
  end function plan_transient

  !> Lines of the plan about steps and kept states.
  function plan_steps(job) result(text)
    class(transient_job), intent(in) :: job
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')

    if (job%dt > 0.0_wp) then
      text = 'computes: '//show(first_steps(job, 0.0_wp))//' equal steps'//nl &
             //step_given_note//nl
    else
      text = 'computes: the step, halved until the states kept are exact to ' &
             //show(merge(job%wanted(), job%tolerance, job%by_size()))
      if (job%by_size()) text = text//' of the size of the motion'
      if (job%relative > 0.0_wp) text = text//' and '//show(job%relative)//' of the largest'
      text = text//nl
    end if
    if (job%last_only) text = text//'skips: storing states on the way (only the last is ' &
                              //'requested)'//nl
    if (job%tail > 0.0_wp) text = text//'skips: storing states before the last ' &
                                  //show(job%tail)//' (not requested)'//nl
    if (allocated(job%times)) text = text//'skips: storing other states than those at ' &
                                     //things(size(job%times), 'time')//' (not requested)'//nl
    if (job%save_every > 1) text = text//'skips: storing all but one state in ' &
                                   //show(job%save_every)//' (the others are not requested)'//nl
  end function plan_steps

end module viscovib_transient_plan
