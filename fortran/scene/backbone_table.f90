!> A backbone as a table: comma separated, a row a motion.
module viscovib_backbone_table
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_curve_branch, only: curve_outcomes
  use viscovib_curve_groups, only: listed, stability_names, stability_note, stability_text
  use viscovib_files, only: make_folder
  use viscovib_free_family, only: free_circle, free_family_type
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_status, only: show, status_type
  use viscovib_text_file, only: text_writer
  implicit none
  private

  public :: write_backbone

contains

  !> Write the table NAME in a folder, which is made if need be; the table is there
  !! whole or not at all.
  subroutine write_backbone(folder, name, varies, orders, family, wanted, coordinates, units, &
                            header, status)
    !> What varies: 'amplitude' or 'energy'.
    character(len=*), intent(in) :: folder, name, varies
    integer, intent(in) :: orders(:)
    type(free_family_type), intent(in) :: family
    !> Coordinates shown, and the names and units of all.
    integer, intent(in) :: wanted(:)
    character(len=*), intent(in) :: coordinates(:), units(:)
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    type(text_writer) :: table
    character(len=:), allocatable :: row, note
    integer :: i, j, k, m

    if (counting) call count_up(counted_columns, size(wanted))
    call make_folder(folder)
    call table%create(folder//'/'//name, status)
    if (status%failed()) return
    m = size(orders)
    call table%add_comments(header)
    call table%add_line('# backbone '//trim(curve_outcomes(family%outcome))//'; folds at ' &
                        //varies//' ='//listed(family%folds))
    if (size(family%branch_p) > 0) call table%add_line('# branch points at '//varies//' =' &
                                                       //listed(family%branch_p))
    row = 'nu'
    note = '# nu: circular frequency'
    if (allocated(family%energy)) row = row//',energy'
    if (allocated(family%multipliers)) then
      row = row//stability_names
      note = note//stability_note
    end if
    note = note//'; u = sum_k a_k cos(k nu t)'
    do i = 1, size(wanted)
      note = note//', '//trim(coordinates(wanted(i)))//' in '//trim(units(wanted(i)))
      do k = 1, m
        row = row//','//trim(coordinates(wanted(i)))//'_'//show(orders(k))
      end do
    end do
    call table%add_line(note)
    call table%add_line(row)
    do i = 1, size(family%nu)
      row = trim(exact(family%nu(i)))
      if (allocated(family%energy)) row = row//','//trim(exact(family%energy(i)))
      if (allocated(family%multipliers)) then
        associate (multipliers => family%multipliers(:, i))
          row = row//','//stability_text(count_larger(multipliers, free_circle), multipliers(1))
        end associate
      end if
      do j = 1, size(wanted)
        do k = 1, m
          row = row//','//trim(exact(family%x((wanted(j) - 1)*m + k, i)))
        end do
      end do
      call table%add_line(row)
    end do
    call table%finish(status)
  end subroutine write_backbone

end module viscovib_backbone_table
