!> Lines of a plan: computations that are skipped, and laws that need extra work.
module viscovib_plan_text
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: called
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: show, things
  implicit none
  private

  public :: report_idle, report_laws, report_table, report_zeros

  character(len=*), parameter :: nl = new_line('a')

contains

  !> Terms, kernels and loads with coefficient 0.
  function report_zeros(system, load) result(text)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text

    text = ''
    if (system%n_zero > 0) text = text//'skips: '//things(system%n_zero, 'nonlinear term') &
                                  //' (coefficient 0)'//nl
    if (system%n_silent > 0) text = text//'skips: memory of '//things(system%n_silent, 'kernel') &
                                    //' (factor 0)'//nl
    text = text//report_table(load)
    if (size(load%orders) == 0 .and. .not. load%has_table()) then
      text = text//'skips: the load (there is none)'//nl
    else if (load%n_zero > 0) then
      text = text//'skips: '//things(load%n_zero, 'order')//' of the load (amplitude 0)'//nl
    end if
  end function report_zeros

  !> Loads by a table.
  function report_table(load) result(text)
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    integer :: n
    text = ''
    if (.not. load%has_table()) return
    n = size(load%table%breaks)
    text = 'computes: force by a table of '//things(n, 'time')//', '//show(load%table%breaks(1)) &
           //' to '//show(load%table%breaks(n))//nl
  end function report_table

  !> Coordinates that stay at rest.
  function report_idle(moved) result(text)
    logical, intent(in) :: moved(:)
    character(len=:), allocatable :: text
    text = ''
    if (.not. all(moved)) text = 'skips: '//things(count(.not. moved), 'coordinate')//' at rest ' &
                                 //'(neither moved by load or start nor coupled to one that is)'//nl
  end function report_idle

  !> Laws evaluated in Python, and laws with a nonzero force at rest.
  function report_laws(system) result(text)
    class(oscillator_type), intent(in) :: system
    character(len=:), allocatable :: text
    text = ''
    if (n_outside(system) > 0) then
      text = 'computes: '//things(n_outside(system), 'law')//' in Python, each time it is needed ' &
             //'(a text would be computed faster)'//nl
    end if
    if (force_at_rest(system) > 0.0_wp) then
      text = text//'computes: the static preload of laws that are not 0 at rest (up to ' &
             //show(force_at_rest(system))//')'//nl
    end if
  end function report_laws

  !> Number of laws that call functions outside of the core, without compiled ones.
  integer function n_outside(system)
    class(oscillator_type), intent(in) :: system
    integer :: i
    n_outside = 0
    select type (system)
    class is (polynomial_type)
      do i = 1, size(system%laws)
        associate (program => system%laws(i)%program)
          if (any(program%code > called .and. program%number > 0.0_wp)) n_outside = n_outside + 1
        end associate
      end do
    end select
  end function n_outside

  !> Largest force at rest of nonpolynomial laws, such as a contact with a negative gap.
  real(wp) function force_at_rest(system)
    class(oscillator_type), intent(in) :: system
    real(wp) :: value(1)
    integer :: i
    force_at_rest = 0.0_wp
    select type (system)
    class is (polynomial_type)
      do i = 1, size(system%laws)
        associate (law => system%laws(i))
          if (law%state > 0) cycle
          call law%program%evaluate(reshape([real(wp) ::], [1, size(law%arguments, 1)], &
                                            pad=[0.0_wp]), value)
          force_at_rest = max(force_at_rest, abs(value(1)))
        end associate
      end do
    end select
  end function force_at_rest

end module viscovib_plan_text
