!> Common parts of tables of curves: columns and notes about stability.
module viscovib_curve_columns
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_crossings, only: crossing_names, crossing_type
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_polar, only: modulus
  use viscovib_status, only: show
  use viscovib_table, only: listed, table_type
  implicit none
  private

  public :: add_stability, note_crossings, note_folds

contains

  !> Note the outcome of a curve, its folds, and their errors.
  subroutine note_folds(table, curve, outcome, varies, folds, errors)
    type(table_type), intent(inout) :: table
    !> Name of the curve, its outcome, name of the varied quantity.
    character(len=*), intent(in) :: curve, outcome, varies
    real(wp), intent(in) :: folds(:), errors(:)
    call table%note(curve//' '//trim(outcome)//'; folds at '//varies//' ='//listed(folds))
    if (size(folds) > 0) call table%note('estimated errors of these folds:'//listed(errors))
  end subroutine note_folds

  !> A line for each change of stability.
  subroutine note_crossings(table, crossings, varies)
    type(table_type), intent(inout) :: table
    type(crossing_type), intent(in) :: crossings(:)
    !> Name of the varied quantity.
    character(len=*), intent(in) :: varies
    character(len=:), allocatable :: row
    integer :: i
    do i = 1, size(crossings)
      row = 'stability changes after point '//show(crossings(i)%before)//': ' &
            //trim(crossing_names(crossings(i)%kind))
      if (crossings(i)%located) row = row//' at '//varies//' = '//trim(exact(crossings(i)%p))
      call table%note(row)
    end do
    if (size(crossings) == 0) return
    call table%note('estimated errors of these changes:' &
                    //listed(merge(crossings%error, ieee_value(0.0_wp, ieee_quiet_nan), &
                                   crossings%located)))
  end subroutine note_crossings

  !> Columns about stability: number of multipliers outside the unit circle, -1: unknown, and
  !! the largest multiplier, NaN: unknown.
  subroutine add_stability(table, growing, largest)
    type(table_type), intent(inout) :: table
    integer, intent(in), target :: growing(:)
    complex(wp), intent(in) :: largest(:)

    call table%hold_integers('stable', merge(growing, merge(1, 0, growing == 0), growing < 0))
    call table%hold_integers('growing', growing)
    call table%hold_reals('multiplier', modulus(largest))
  end subroutine add_stability

end module viscovib_curve_columns
