!> A backbone as a table, a row a motion.
module viscovib_backbone_table
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_curve_branch, only: curve_outcomes
  use viscovib_curve_groups, only: add_stability, stability_note
  use viscovib_free_family, only: free_circle, free_family_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_status, only: show, status_type
  use viscovib_table, only: listed, listed_units, table_type
  implicit none
  private

  public :: write_backbone

contains

  !> Write the table NAME in a folder.
  subroutine write_backbone(folder, name, varies, orders, family, wanted, coordinates, units, &
                            header, status)
    !> What varies: 'amplitude' or 'energy'.
    character(len=*), intent(in) :: folder, name, varies
    integer, intent(in) :: orders(:)
    type(free_family_type), intent(in), target :: family
    !> Coordinates shown, and the names and units of all.
    integer, intent(in) :: wanted(:)
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: note
    integer :: i, k

    if (counting) call count_up(counted_columns, size(wanted))
    call table%note('backbone '//trim(curve_outcomes(family%outcome))//'; folds at '//varies &
                    //' ='//listed(family%folds))
    if (size(family%branch_p) > 0) call table%note('branch points at '//varies//' =' &
                                                   //listed(family%branch_p))
    call table%add_reals('nu', family%nu)
    if (allocated(family%energy)) call table%add_reals('energy', family%energy)
    note = 'nu: circular frequency'
    if (allocated(family%multipliers)) then
      note = note//stability_note
      call add_stability(table, [(count_larger(family%multipliers(:, i), free_circle), &
                                  i=1, size(family%nu))], family%multipliers(1, :))
    end if
    call table%note(note//'; u = sum_k a_k cos(k nu t); ' &
                    //listed_units(coordinates(wanted), units(wanted)))
    do i = 1, size(wanted)
      do k = 1, size(orders)
        call table%add_reals(trim(coordinates(wanted(i)))//'_'//show(orders(k)), &
                             family%x((wanted(i) - 1)*size(orders) + k, :))
      end do
    end do
    call table%write(folder, name, header, status)
  end subroutine write_backbone

end module viscovib_backbone_table
