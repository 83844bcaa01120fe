!> Limits for the length of a part of a step due to the forces on it.
module viscovib_part_lengths
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: unseen
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: look_for_layers, look_for_stiff

contains

  !> Length that the last part should have had because of thin layers of forces in it. Once a layer
  !! may have been missed, all later parts resolve layers.
  subroutine look_for_layers(path, system, until, h, length)
    type(step_path), intent(in) :: path
    class(driven_system_type), intent(inout) :: system
    !> End of the step; length of the part.
    real(wp), intent(in) :: until, h
    real(wp), intent(out) :: length
    !> Shortest part relative to the step of the run; largest reduction at once.
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

  !> The same for stiff forces, up to a position in the part. Parts that end or begin on a
  !! surface, and parts of steps that failed as a whole, may be equal for all step
  !! sizes: a comparison of runs would not show their errors.
  subroutine look_for_stiff(path, system, place, h, length)
    type(step_path), intent(in) :: path
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: place, h
    real(wp), intent(inout) :: length
    !> Largest number of parts.
    real(wp), parameter :: most = 1.0e6_wp
    real(wp) :: longest
    integer :: n
    n = max(1, count(path%points <= place))
    longest = system%longest_part(path%q(:n, :), path%v(:n, :))
    if (place*h > longest) length = min(length, place*h/ceiling(min(place*h/longest, most)))
  end subroutine look_for_stiff

end module viscovib_part_lengths
