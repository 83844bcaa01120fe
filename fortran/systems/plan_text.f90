!> Lines of a plan: what is left out because it would change nothing.
module viscovib_plan_text
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: things
  implicit none
  private

  public :: tell_zeros, tell_idle

  character(len=*), parameter :: nl = new_line('a')

contains

  !> Terms, kernels and loads that are 0.
  function tell_zeros(system, load) result(text)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text

    text = ''
    if (system%n_zero > 0) text = text//'skips: '//things(system%n_zero, 'nonlinear term') &
                                  //' (coefficient 0)'//nl
    if (system%n_silent > 0) text = text//'skips: memory of '//things(system%n_silent, 'kernel') &
                                    //' (factor 0)'//nl
    if (size(load%orders) == 0) then
      text = text//'skips: the load (there is none)'//nl
    else if (load%n_zero > 0) then
      text = text//'skips: '//things(load%n_zero, 'order')//' of the load (amplitude 0)'//nl
    end if
  end function tell_zeros

  !> Coordinates that nothing moves.
  function tell_idle(moved) result(text)
    logical, intent(in) :: moved(:)
    character(len=:), allocatable :: text
    text = ''
    if (.not. all(moved)) text = 'skips: '//things(count(.not. moved), 'coordinate')//' at rest ' &
                                 //'(neither moved by load or start nor coupled to one that is)'//nl
  end function tell_idle

  !> A number of things, '1 term' or '2 terms'.
end module viscovib_plan_text
