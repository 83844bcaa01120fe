!> Modal frame of the linear subsystem of a polynomial system (`viscovib_modal_frame`).
module viscovib_polynomial_frame
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term, part_linear
  use viscovib_modal_frame, only: modal_frame, new_modal_frame
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, status_input_error, status_type
  implicit none
  private

  public :: new_polynomial_frame

contains

  !> Include the linear parts of the laws.
  subroutine new_polynomial_frame(frame, pace, system, n_hidden, status)
    type(modal_frame), intent(out) :: frame
    !> Largest rate of the coordinates and of the arguments of laws (rad/s).
    real(wp), intent(out) :: pace
    type(polynomial_type), intent(in) :: system
    !> Number of last coordinates that represent memory.
    integer, intent(in) :: n_hidden
    type(status_type), intent(inout) :: status
    real(wp), dimension(system%n_dof(), system%n_dof()) :: identity, stiffness, damping
    type(law_term) :: laws(size(system%laws))
    real(wp), allocatable :: seen(:, :)
    logical :: found
    integer :: i

    pace = 0.0_wp
    identity = 0.0_wp
    do i = 1, size(identity, 1)
      identity(i, i) = 1.0_wp
    end do
    stiffness = system%stiffness_at_rest()
    damping = system%damping
    laws = system%laws
    call part_linear(laws, identity, stiffness, damping)
    call new_modal_frame(frame, system%mass, damping, stiffness, n_hidden, found)
    if (found) then
      allocate (seen(0, size(identity, 1)))
      do i = 1, size(laws)
        call add_rows(seen, system%laws(i)%arguments)
        call add_rows(seen, system%laws(i)%rates)
      end do
      pace = frame%pace(seen)
      return
    end if
    call fail(status, status_input_error, 'mass', 'mass: must be symmetric and positive definite ' &
              //'in a motion in time of so many coordinates')
  end subroutine new_polynomial_frame

  subroutine add_rows(rows, more)
    real(wp), allocatable, intent(inout) :: rows(:, :)
    real(wp), intent(in) :: more(:, :)
    real(wp) :: all_of_them(size(rows, 1) + size(more, 1), size(rows, 2))
    all_of_them(:size(rows, 1), :) = rows
    all_of_them(size(rows, 1) + 1:, :) = more
    rows = all_of_them
  end subroutine add_rows

end module viscovib_polynomial_frame
