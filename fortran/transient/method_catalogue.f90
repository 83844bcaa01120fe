! Optimize: -O2
!> The methods of time integration by name.
module viscovib_method_catalogue
  use viscovib_driven_system, only: driven_system_type
  use viscovib_explicit_stepper, only: explicit_stepper_type, new_explicit_stepper
  use viscovib_explicit_tables, only: explicit_names
  use viscovib_gauss, only: gauss_type, new_gauss
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_modal_gauss, only: modal_gauss_type, new_modal_gauss
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: new_stepper, method_order, takes_sections

  !> Gauss collocations, by number of nodes, then the explicit methods.
  character(len=*), parameter, public :: transient_methods(8) = &
    [character(len=8) :: 'gauss8', 'gauss16', 'gauss2', 'gauss3', explicit_names]
  integer, parameter :: nodes(4) = [8, 16, 2, 3], explicit_orders(4) = [4, 8, 8, 9]

contains

  !> A stepper at (q, v), by the index of its method in `transient_methods`.
  subroutine new_stepper(stepper, system, method, q, v, start, h, tolerance)
    class(stepper_type), allocatable, intent(out) :: stepper
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: method
    !> State (n_dof); start time; step; relative change of accelerations
    !! at which the equations of a collocation count as solved.
    real(wp), intent(in) :: q(:), v(:), start, h, tolerance
    type(gauss_type), allocatable :: gauss
    type(explicit_stepper_type), allocatable :: explicit
    type(modal_gauss_type), allocatable :: modal

    if (allocated(system%frame) .and. takes_sections(method)) then
      allocate (modal)
      call new_modal_gauss(modal, system, nodes(method), q, v, start, h, tolerance)
      call move_alloc(modal, stepper)
    else if (method <= size(nodes)) then
      allocate (gauss)
      call new_gauss(gauss, system, nodes(method), q, v, start, h, tolerance)
      call move_alloc(gauss, stepper)
    else
      allocate (explicit)
      call new_explicit_stepper(explicit, system, method - size(nodes), q, v, start, h)
      call move_alloc(explicit, stepper)
    end if
  end subroutine new_stepper

  !> True if a method can integrate the sections of a linear subsystem exactly: its polynomials are
  !! of supported orders.
  pure logical function takes_sections(method)
    integer, intent(in) :: method
    takes_sections = .false.
    if (method <= size(nodes)) takes_sections = nodes(method) <= n_lanes
  end function takes_sections

  pure integer function method_order(method)
    integer, intent(in) :: method
    if (method <= size(nodes)) then
      method_order = 2*nodes(method)
    else
      method_order = explicit_orders(method - size(nodes))
    end if
  end function method_order

end module viscovib_method_catalogue
