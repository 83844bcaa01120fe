!> Structures with few coordinates as uncondensed equations, whose time steps end where laws switch.
!!
!! M u'' + C u' + K u + sum_j e_j f_j(e_j . u, e_j . u') = load. Modal damping gives C in terms of
!! all modes: C = M Phi diag(rates) Phi^T M, Phi^T M Phi = 1. Kernels of elements may be
!! exponentials.
module viscovib_whole_structure
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_modal_frame, only: is_definite, most_in_frame
  use viscovib_law_program, only: branches
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: status_type
  use viscovib_structure_elements, only: element_type, put_laws
  use viscovib_structure_model, only: add_linear, structure_model
  implicit none
  private

  public :: has_states, may_be_whole, switches, whole_polynomial

  !> Message about models for which `may_be_whole` is false.
  character(len=*), parameter, public :: whole_only = 'is for structures of at most 512 ' &
    //'coordinates, all with mass, not reduced, without loss factors'

contains

  !> True if the model is small, its mass matrix is positive definite and all damping is viscous.
  pure logical function may_be_whole(model) result(may)
    type(structure_model), intent(in) :: model
    may = .false.
    if (model%is_reduced .or. size(model%mass, 1) > most_in_frame) return
    if (.not. is_definite(model%mass)) return
    may = .not. abs(model%modal%loss) > 0.0_wp
  end function may_be_whole

  !> True if the model also has laws with kinks or jumps, or elements with states.
  pure logical function switches(model)
    type(structure_model), intent(in) :: model
    integer :: i, j

    switches = .false.
    if (.not. may_be_whole(model)) return
    switches = has_states(model)
    do i = 1, size(model%elements)
      do j = 1, size(model%elements(i)%laws)
        switches = switches .or. any(branches(model%elements(i)%laws(j)%program%code))
      end do
    end do
  end function switches

  !> True if an element has hysteresis.
  pure logical function has_states(model)
    type(structure_model), intent(in) :: model
    integer :: i
    has_states = any([(any(model%elements(i)%laws%state > 0), i=1, size(model%elements))])
  end function has_states

  !> The polynomial system in all coordinates.
  subroutine whole_polynomial(model, kernels, system, status)
    type(structure_model), intent(in) :: model
    type(kernel_holder), intent(in) :: kernels(:)
    type(polynomial_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(polynomial_parameters) :: p
    type(structure_model) :: elastic
    type(element_type) :: elements(size(model%elements))
    real(wp), dimension(size(model%mass, 1), size(model%mass, 1)) :: stiffness, damping
    integer :: a, i, n

    n = size(model%mass, 1)
    elastic = model
    call elastic%fix_damping(status)
    if (status%failed()) return
    ! Stiffness that does not relax.
    where (elastic%elements%kernel > 0) elastic%elements%stiffness = 0.0_wp
    call add_linear(elastic, stiffness, damping)
    elements = model%elements
    do i = 1, size(elements)
      if (elements(i)%is_active()) elements(i)%mix = elements(i)%direction
    end do
    call put_laws(elements, n, size(kernels), p)
    p%speed_matrices = model%speed_matrices
    p%stiffness(:, :, 1) = p%stiffness(:, :, 1) + stiffness
    p%mass = model%mass
    p%damping = damping
    p%base_direction = [(0.0_wp, a=1, n)]
    if (allocated(model%base_direction)) p%base_direction = model%base_direction
    call new_polynomial(system, p, kernels, status)
  end subroutine whole_polynomial

end module viscovib_whole_structure
