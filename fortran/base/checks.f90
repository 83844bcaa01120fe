! Optimize: -O3
!> Checks of input values. Each failure message is one line with the argument, its value and the
!! allowed range.
module viscovib_checks
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: check_finite, check_positive, check_not_negative, check_fraction, check_increasing

  interface check_finite
    module procedure check_finite_scalar, check_finite_vector
  end interface check_finite

contains

  subroutine check_finite_scalar(name, value, status)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: value
    type(status_type), intent(out) :: status
    if (.not. ieee_is_finite(value)) then
      call fail(status, status_input_error, name, &
                name//' = '//show(value)//': must be a finite number')
    end if
  end subroutine check_finite_scalar

  subroutine check_finite_vector(name, values, status)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)
    type(status_type), intent(out) :: status
    integer :: i
    do i = 1, size(values)
      if (.not. ieee_is_finite(values(i))) then
        call fail(status, status_input_error, name, &
                  name//' (value '//show(i)//') = '//show(values(i))//': must be a finite number')
        return
      end if
    end do
  end subroutine check_finite_vector

  !> value > 0 and finite.
  subroutine check_positive(name, value, status)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: value
    type(status_type), intent(out) :: status
    call check_finite(name, value, status)
    if (status%failed()) return
    if (value <= 0.0_wp) then
      call fail(status, status_input_error, name, &
                name//' = '//show(value)//': must be greater than 0')
    end if
  end subroutine check_positive

  !> value >= 0 and finite.
  subroutine check_not_negative(name, value, status)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: value
    type(status_type), intent(out) :: status
    call check_finite(name, value, status)
    if (status%failed()) return
    if (value < 0.0_wp) then
      call fail(status, status_input_error, name, &
                name//' = '//show(value)//': must not be negative')
    end if
  end subroutine check_not_negative

  !> 0 < value <= 1.
  subroutine check_fraction(name, value, status)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: value
    type(status_type), intent(out) :: status
    call check_finite(name, value, status)
    if (status%failed()) return
    if (value <= 0.0_wp .or. value > 1.0_wp) then
      call fail(status, status_input_error, name, name//' = '//show(value)//': must be in (0, 1]')
    end if
  end subroutine check_fraction

  !> Finite and strictly increasing.
  subroutine check_increasing(name, values, status)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)
    type(status_type), intent(out) :: status
    integer :: i
    call check_finite(name, values, status)
    if (status%failed()) return
    do i = 2, size(values)
      if (values(i) <= values(i - 1)) then
        call fail(status, status_input_error, name, &
                  name//' (value '//show(i)//') = '//show(values(i))//' after ' &
                  //show(values(i - 1))//': must be strictly increasing')
        return
      end if
    end do
  end subroutine check_increasing

end module viscovib_checks
