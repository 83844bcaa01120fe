!> Impacts in the presence of stops that are already in contact.
module viscovib_stops_at_rest
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: slides
  use viscovib_switched_laws, only: switched_laws
  implicit none
  private

  public :: push_on

contains

  !> Apply successive impacts to the closed stops until none is penetrated.
  subroutine push_on(laws, first, v, sides)
    type(switched_laws), intent(inout) :: laws
    !> Surface of the stop that was hit first.
    integer, intent(in) :: first
    real(wp), intent(inout) :: v(:)
    integer, intent(inout) :: sides(:)
    integer, parameter :: most = 100
    real(wp) :: n(size(v)), b(size(v)), away
    integer :: i, k
    logical :: settled

    do i = 1, most
      settled = .true.
      do k = 1, size(sides)
        if (laws%element_of(k) == 0 .or. (sides(k) /= slides .and. k /= first)) cycle
        call laws%normal(k, n, b)
        away = dot_product(n, v)
        if (abs(away) <= 1.0e-14_wp*sum(abs(n*v))) cycle
        if (away > 0.0_wp) then
          sides(k) = 1
          laws%elements(laws%element_of(k))%since(laws%which(k)) = -1.0_wp
        else
          settled = .false.
          v = v - (1.0_wp + laws%elements(laws%element_of(k))%restitution) &
              *(away/dot_product(n, b))*b
        end if
      end do
      if (settled) return
    end do
  end subroutine push_on

end module viscovib_stops_at_rest
