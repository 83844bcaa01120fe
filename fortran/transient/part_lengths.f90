!> How long a part of a step may be because of the forces on it.
module viscovib_part_lengths
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: unseen
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: look_for_layers, look_for_stiff

contains

  !> How long the part just made should have been because of thin layers of forces in it. Once one
  !! may have been missed, all that follow are seen well.
  subroutine look_for_layers(path, system, until, h, length)
    type(step_path), intent(in) :: path
    class(driven_system_type), intent(inout) :: system
    !> Where the step ends; the part's length.
    real(wp), intent(in) :: until, h
    real(wp), intent(out) :: length
    !> The shortest part as one of the step of the run; a part is made that much shorter at once.
    real(wp), parameter :: least = 1.0e-12_wp, most = 1.0_wp/32.0_wp
    real(wp) :: thin

    length = h
    if (.not. system%layers%exist()) return
    if (h <= max(least*system%step_length, 64.0_wp*spacing(until))) return
    thin = system%layers%thinness_at(path%start + h*path%points, path%points, path%q, path%v, &
                                     .false.)
    if (thin > unseen) system%in_parts = .true.
    if (system%in_parts .and. thin > system%thin) then
      length = h*min(0.5_wp, max(most, system%thin/thin))
    end if
  end subroutine look_for_layers

  !> The same because of stiff forces, up to a place of the part. Parts that end or begin on a
  !! surface, and those of steps that could not be made at once, may be the same in steps of any
  !! length: no comparison of runs would show their errors.
  subroutine look_for_stiff(path, system, place, h, length)
    type(step_path), intent(in) :: path
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: place, h
    real(wp), intent(inout) :: length
    !> Parts at most.
    real(wp), parameter :: most = 1.0e6_wp
    real(wp) :: longest
    integer :: n
    n = max(1, count(path%points <= place))
    longest = system%longest_part(path%q(:n, :), path%v(:n, :))
    if (place*h > longest) length = min(length, place*h/ceiling(min(place*h/longest, most)))
  end subroutine look_for_stiff

end module viscovib_part_lengths
