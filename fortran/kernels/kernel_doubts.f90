!> Doubts about kernels: an integral that leaves no stiffness or that no relaxation has, and the
!! part of it that a table does not hold.
module viscovib_kernel_doubts
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_rounded, only: brief
  use viscovib_tabulated, only: unseen_integral
  implicit none
  private

  public :: doubt_integral, doubt_table

  !> A table that omits more than this fraction of its integral causes a warning.
  real(wp), parameter :: unseen = 0.01_wp

contains

  !> A line if the integral of a kernel, with its factor, is not between 0 and 1; else empty.
  subroutine doubt_integral(total, text)
    real(wp), intent(in) :: total
    character(len=:), allocatable, intent(out) :: text
    text = ''
    if (total >= 1.0_wp) then
      text = 'kernel integral = '//brief(total)//' >= 1: the relaxed stiffness is not positive, ' &
             //'and free motion creeps away slowly; the forced response to a load without a ' &
             //'mean is unaffected'
    else if (total < 0.0_wp) then
      text = 'kernel integral = '//brief(total)//' < 0: the spring stiffens with time, which no ' &
             //'relaxation does'
    end if
  end subroutine doubt_integral

  !> A line if a table does not hold its integral.
  subroutine doubt_table(kernel, text)
    class(kernel_type), intent(in) :: kernel
    character(len=:), allocatable, intent(out) :: text
    text = ''
    if (unseen_integral(kernel) > unseen*abs(kernel%integral())) then
      text = 'kernel table: its first values rise towards t = 0 like a power of t: an integral ' &
             //'of about '//brief(unseen_integral(kernel))//' lies before its first time, which ' &
             //'the table does not contain; the integral of the table is '//brief(kernel%integral())
    end if
  end subroutine doubt_table

end module viscovib_kernel_doubts
