!> Initial states of hysteresis elements at the start of a solution.
module viscovib_elements_at_start
  use viscovib_kinds, only: wp
  use viscovib_switched_laws, only: switched_laws
  implicit none
  private

  public :: begin_elements

contains

  !> Set every hysteresis element from its deflection and deflection rate.
  subroutine begin_elements(laws, q, v)
    type(switched_laws), intent(inout) :: laws
    !> Shape (n_dof).
    real(wp), intent(in) :: q(:), v(:)
    real(wp) :: d(1), rate(1)
    integer :: i

    do i = 1, size(laws%elements)
      d = laws%deflection(i, reshape(q, [1, size(q)]))
      rate = laws%deflection(i, reshape(v, [1, size(v)]))
      call laws%elements(i)%set(d(1), rate(1))
    end do
  end subroutine begin_elements

end module viscovib_elements_at_start
