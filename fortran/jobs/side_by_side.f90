!> Grouping of motions in lanes: their systems must have the same form.
module viscovib_side_by_side
  use viscovib_lane_motion, only: lane_motion_type
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: place_of_form, fill_blocks

contains

  !> Index of a motion's form among the known ones; a new form is appended.
  integer function place_of_form(known, motion) result(place)
    type(lane_motion_type), allocatable, intent(inout) :: known(:)
    type(lane_motion_type), intent(in) :: motion
    type(lane_motion_type), allocatable :: more(:)
    integer :: i

    do place = 1, size(known)
      if (known(place)%differs_in_numbers(motion)) return
    end do
    allocate (more(place))
    do i = 1, size(known)
      more(i) = known(i)
    end do
    more(place) = motion
    call move_alloc(more, known)
  end function place_of_form

  !> Blocks of motions of one kind; the last motion is repeated in idle lanes.
  pure subroutine fill_blocks(kind_of, members, kinds)
    !> The kind of each motion, from 1.
    integer, intent(in) :: kind_of(:)
    !> The motions of each block, and its kind.
    integer, allocatable, intent(out) :: members(:, :), kinds(:)
    integer, allocatable :: all_of_them(:), runs(:)
    integer :: i, k

    allocate (all_of_them(0), kinds(0))
    do k = 1, maxval(kind_of)
      runs = pack([(i, i=1, size(kind_of))], kind_of == k)
      runs = [runs, (runs(size(runs)), i=1, modulo(-size(runs), n_lanes))]
      all_of_them = [all_of_them, runs]
      kinds = [kinds, (k, i=1, size(runs)/n_lanes)]
    end do
    members = reshape(all_of_them, [n_lanes, size(kinds)])
  end subroutine fill_blocks

end module viscovib_side_by_side
