! Optimize: -O1
!> Coordinates that stay at rest, and the system without them.
!!
!! Coordinates coupled by mass, damping, springs or a product in a force form a group. A group
!! without a driven coordinate stays at rest and acts on no other group, so the equations of the
!! remaining groups are complete without it.
module viscovib_reduction
  use viscovib_kernel_holder, only: copy_kernels
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: read_rates
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  implicit none
  private

  public :: moved_coordinates, reduce

contains

  !> Coordinates of the groups with a driven coordinate; all coordinates if none is driven.
  pure function moved_coordinates(system, driven) result(moved)
    class(oscillator_type), intent(in) :: system
    !> Shape (n_dof).
    logical, intent(in) :: driven(:)
    logical :: moved(size(driven)), coupled(size(driven), size(driven))
    integer :: i, a

    moved = driven .or. .not. any(driven)
    if (all(moved)) return
    coupled = system%coupling()
    do i = 1, size(driven)
      do a = 1, size(driven)
        moved(a) = moved(a) .or. any(coupled(:, a) .and. moved)
      end do
    end do
  end function moved_coordinates

  !> The system of the kept coordinates. They must be whole groups, as `moved_coordinates` returns
  !! them.
  subroutine reduce(system, kept, reduced)
    class(oscillator_type), intent(in) :: system
    !> Shape (n_dof).
    logical, intent(in) :: kept(:)
    type(polynomial_type), intent(out) :: reduced
    integer :: place(size(kept)), variable(system%n_memory())
    integer, allocatable :: dofs(:), variables(:)
    integer :: i, n

    dofs = pack([(i, i=1, size(kept))], kept)
    place = 0
    place(dofs) = [(i, i=1, size(dofs))]
    variables = pack([(i, i=1, size(variable))], &
                     [(any(abs(system%spread(dofs, i)) > 0.0_wp), i=1, size(variable))])
    variable = 0
    variable(variables) = [(i, i=1, size(variables))]
    reduced%mass = system%mass(dofs, dofs)
    reduced%damping = system%damping(dofs, dofs)
    reduced%gather = system%gather(variables, dofs)
    reduced%spread = system%spread(dofs, variables)
    reduced%kernel_of = system%kernel_of(variables)
    reduced%bent = system%bent(variables)
    reduced%base_direction = system%base_direction(dofs)
    if (allocated(system%space_damping)) then
      reduced%space_damping = system%space_damping(dofs, dofs)
      reduced%space_stiffness = system%space_stiffness(dofs, dofs)
    end if
    reduced%speed_matrices = system%matrices_of(dofs)
    call copy_kernels(system%kernels, reduced%kernels)
    select type (system)
    type is (polynomial_type)
      allocate (reduced%monomials(count([(kept(system%monomials(i)%equation), &
                                          i=1, size(system%monomials))])))
      n = 0
      do i = 1, size(system%monomials)
        if (.not. kept(system%monomials(i)%equation)) cycle
        n = n + 1
        reduced%monomials(n) = system%monomials(i)
      end do
      allocate (reduced%laws(count([(kept(system%laws(i)%equations(1)), i=1, size(system%laws))])))
      n = 0
      do i = 1, size(system%laws)
        if (.not. kept(system%laws(i)%equations(1))) cycle
        n = n + 1
        reduced%laws(n) = system%laws(i)
      end do
    class default
      allocate (reduced%monomials(0), reduced%laws(0))
    end select
    do i = 1, size(reduced%monomials)
      associate (m => reduced%monomials(i))
        m%equation = place(m%equation)
        m%variable = variable(m%variable)
        m%dof = place(m%dof)
      end associate
    end do
    do i = 1, size(reduced%laws)
      associate (law => reduced%laws(i))
        law%arguments = law%arguments(:, dofs)
        law%rates = law%rates(:, dofs)
        law%equations = place(law%equations)
        law%variables = variable(law%variables)
      end associate
    end do
    associate (degrees => [(sum(reduced%monomials(i)%power), i=1, size(reduced%monomials))])
      reduced%odd = all(mod(degrees, 2) == 1) .and. all(reduced%laws%parity == -1)
      reduced%degree = 0
      if (all(reduced%laws%degree > 0)) reduced%degree = maxval([1, degrees, reduced%laws%degree])
    end associate
    call read_rates(reduced%laws, size(dofs), reduced%rates)
  end subroutine reduce

end module viscovib_reduction
