!> Campbell diagram of a rotor: a table of its complex modes over the speed.
module viscovib_campbell_job
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_campbell, only: campbell_type, find_campbell
  use viscovib_job, only: job_report, job_type, table_sink
  use viscovib_kinds, only: wp
  use viscovib_rotor_modes, only: check_modes
  use viscovib_status, only: show, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: listed, table_type
  implicit none
  private

  public :: campbell_job

  type, extends(job_type) :: campbell_job
    !> Increasing (rad/s); orders of the critical speeds.
    real(wp), allocatable :: speeds(:), orders(:)
    !> Two coordinates whose direction of whirl is wanted, 0: none.
    integer :: plane(2) = 0
  contains
    procedure :: plan => plan_campbell
    procedure :: run
  end type campbell_job

contains

  subroutine plan_campbell(self, subject, text, status)
    class(campbell_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    text = ''
    call check_modes(subject%polynomial, status)
    if (status%failed()) return
    text = 'computes: complex modes about rest at '//things(size(self%speeds), 'speed') &
           //', critical speeds, loss of stability'//new_line('a') &
           //'skips: loads and nonlinear terms'//new_line('a')
  end subroutine plan_campbell

  subroutine run(self, subject, sink, report, status)
    class(campbell_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(campbell_type) :: found
    type(table_type) :: table
    real(wp), allocatable :: whirl(:, :)
    integer :: i, k

    call find_campbell(subject%polynomial, self%speeds, self%orders, found, status)
    if (status%failed()) return
    call table%note('speed (rad/s); growth: largest real part of all eigenvalues s (1/s); ' &
                    //'frequency: Im s (rad/s); damping_ratio: -Re s/|s|; nan: does not oscillate')
    do i = 1, size(self%orders)
      call table%note('critical speeds (rad/s) of order '//show(self%orders(i))//':' &
                      //listed(pack([(found%critical(k)%speed, k=1, size(found%critical))], &
                                    abs(found%critical%order - self%orders(i)) <= 0.0_wp)))
    end do
    if (.not. ieee_is_nan(found%threshold)) then
      call table%note('unstable from this speed on (rad/s):'//listed([found%threshold]))
    else
      call table%note('no eigenvalue has a positive real part')
    end if
    if (self%plane(1) > 0) then
      call table%note('whirl: 1 forward, -1 backward on a circle, 0 on a line')
      allocate (whirl, source=found%whirl(self%plane))
    end if
    call table%hold_reals('speed', found%speeds)
    call table%hold_reals('growth', found%growth)
    do i = 1, size(found%roots, 1)
      call table%hold_reals('frequency_'//show(i - 1), aimag(found%roots(i, :)))
      call table%hold_reals('damping_ratio_'//show(i - 1), &
                            -real(found%roots(i, :))/abs(found%roots(i, :)))
      if (self%plane(1) == 0) cycle
      call table%hold_reals('whirl_'//show(i - 1), whirl(i, :))
    end do
    call sink%put(self%kind, table, status)
    report%summary = things(size(found%roots, 1), 'mode')//', ' &
                     //things(size(found%critical), 'critical speed')
    if (.not. ieee_is_nan(found%threshold)) then
      report%summary = report%summary//', unstable from '//show(found%threshold)//' on'
    end if
  end subroutine run

end module viscovib_campbell_job
