!> Functions outside of the core that laws call by number, such as functions written in Python.
!!
!! The host program registers one procedure that calls the function with a given number. A function
!! receives whole arrays of samples and returns values and derivatives. It must be deterministic.
!! Compiled functions of numbers are called without the host program.
module viscovib_law_outside
  use, intrinsic :: iso_c_binding, only: c_double, c_f_procpointer, c_funptr, c_int, c_int64_t
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: wall, within
  implicit none
  private

  public :: call_outside, set_outside

  abstract interface
    !> Values of a function at samples, and its derivatives by each operand if `wanted` is 1.
    pure subroutine outside_interface(which, n, m, wanted, x, value, by) bind(c)
      import :: c_double, c_int, c_int64_t
      integer(c_int64_t), intent(in), value :: which
      integer(c_int), intent(in), value :: n, m, wanted
      !> Shapes (n, m), (n) and (n, m).
      real(c_double), intent(in) :: x(*)
      real(c_double), intent(inout) :: value(*), by(*)
    end subroutine outside_interface
  end interface

  procedure(outside_interface), pointer :: outside => null()

  interface
    !> Like `outside_interface`, for compiled functions at an address.
    pure subroutine compiled(which, n, m, wanted, x, value, by) &
      bind(c, name='viscovib_compiled_law')
      import :: c_double, c_int, c_int64_t
      integer(c_int64_t), intent(in), value :: which
      integer(c_int), intent(in), value :: n, m, wanted
      real(c_double), intent(in) :: x(*)
      real(c_double), intent(inout) :: value(*), by(*)
    end subroutine compiled
  end interface

contains

  !> Register the procedure that evaluates the functions.
  subroutine set_outside(procedure_at)
    type(c_funptr), intent(in) :: procedure_at
    call c_f_procpointer(procedure_at, outside)
  end subroutine set_outside

  !> Values of a function at samples, and its derivatives by each operand if `wanted`. Values that
  !! are not finite, or of an unregistered function, become `wall`.
  pure subroutine call_outside(which, wanted, x, value, by)
    !> A number, or minus the address of a compiled function and its derivatives.
    real(wp), intent(in) :: which
    logical, intent(in) :: wanted
    !> Shapes (n, m), (n) and (n, m).
    real(wp), intent(in), contiguous :: x(:, :)
    real(wp), intent(out), contiguous :: value(:), by(:, :)
    integer :: k

    value = wall
    by = 0.0_wp
    if (which < 0.0_wp) then
      call compiled(nint(-which, c_int64_t), size(x, 1), size(x, 2), merge(1, 0, wanted), x, &
                    value, by)
    else if (associated(outside)) then
      call outside(nint(which, c_int64_t), size(x, 1), size(x, 2), merge(1, 0, wanted), x, value, &
                   by)
    end if
    do k = 1, size(value)
      if (ieee_is_finite(value(k)) .and. abs(value(k)) < wall) then
        by(k, :) = within(by(k, :))
      else
        value(k) = wall
        by(k, :) = 0.0_wp
      end if
    end do
  end subroutine call_outside

end module viscovib_law_outside
